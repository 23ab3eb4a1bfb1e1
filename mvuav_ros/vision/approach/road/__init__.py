"""Roads and pipelines: strips unlike the land on both sides, searched and followed."""
