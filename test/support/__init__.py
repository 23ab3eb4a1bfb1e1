"""What several tests share: samples, scenes, live graphs, the command."""
