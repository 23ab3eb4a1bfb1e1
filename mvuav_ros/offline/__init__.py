"""Whole recordings at once: replay, sweeps, evaluation."""
