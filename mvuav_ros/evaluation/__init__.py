"""Results against truth, the thesis's experiments on it, and the reports that show both."""
