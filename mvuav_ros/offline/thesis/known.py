"""The numbers of the thesis that we have. Its chapter 5 tables are not among them.

Nothing here is measured by us, and nothing in the report's own columns comes from here.
"""

from __future__ import annotations

FULL_FRAME_MS = 85.0
"""A full-frame detection, ms."""
TRACKED_MS = 30.0
"""A tracked frame, ms."""
WINDOW_SHARE = 0.0072
"""The five search windows' share of the frame by the program: 5 x 21 x 21 of 640 x 480 px."""
WINDOW_SHARE_ABSTRACT = 0.0016
"""The same by the abstract: 5 x 10 x 10 px."""
PREDICTION_RMS_PX = 1.0
"""The conclusion: the RMS of prediction is below this in all trials."""
