"""The same recordings with many parameter sets."""
