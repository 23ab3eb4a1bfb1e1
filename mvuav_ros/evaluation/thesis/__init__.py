"""The experiments of the thesis's chapter 5 on synthetic flights."""
