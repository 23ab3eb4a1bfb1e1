"""What goes wrong with recordings, in words for the person who brought them."""

from __future__ import annotations

from mvuav_ros.recordings.foreign import LONGEST_LINE, words


class RecordingError(Exception):
    """A recording that cannot be read or written; one visible line that says what to do."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, LONGEST_LINE))


class MalformedMessageError(ValueError):
    """A message whose bytes are not what its type asks for; one visible line."""

    def __init__(self, text: object) -> None:
        super().__init__(words(text, LONGEST_LINE))
