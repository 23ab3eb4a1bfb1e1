"""Whole recordings at once: replay, sweeps, evaluation, the thesis report."""
