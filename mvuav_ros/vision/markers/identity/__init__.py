"""Markers followed under their names: found, doubted, lost and found again."""
