"""The documentation's pictures, each drawn by the code that it shows."""
