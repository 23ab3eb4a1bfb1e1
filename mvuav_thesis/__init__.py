"""The experiments of the thesis's chapter 5, made again on simulated flights."""
