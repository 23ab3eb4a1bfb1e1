"""What goes wrong with recordings, in words for the person who brought them."""

from __future__ import annotations


class RecordingError(Exception):
    """A recording that cannot be read or written; one line that says what to do."""


class MalformedMessageError(ValueError):
    """A message whose bytes are not what its type asks for."""
