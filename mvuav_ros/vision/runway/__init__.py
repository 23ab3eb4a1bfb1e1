"""The thesis's runway scheme (chapter 4.3)."""
