"""Draws the documentation's pictures into docs/pictures: make docs-pictures.

Usage: make_doc_pictures.py [FOLDER [NAME...]].
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib

matplotlib.use('Agg')

from doc_pictures.coordinate_frames import body_frames, image_frame, roll_sign, runway_frame
from doc_pictures.marker_stages import lamps, marker_parameters, marker_pipeline
from doc_pictures.name_confidence import name_confidence
from doc_pictures.node_graph import node_graph
from doc_pictures.protection_level import protection_level
from doc_pictures.runway_stages import approach_pipeline, runway_parameters, thesis_pipeline

ROOT = Path(__file__).resolve().parent.parent
PICTURES: Mapping[str, Callable[[Path], None]] = {
    'node_graph.svg': node_graph,
    'frame_image.svg': image_frame,
    'frame_bodies.svg': body_frames,
    'frame_runway.svg': runway_frame,
    'roll_sign.jpg': roll_sign,
    'marker_pipeline.jpg': marker_pipeline,
    'lamps.jpg': lamps,
    'runway_pipeline_thesis.jpg': thesis_pipeline,
    'runway_pipeline_approach.jpg': approach_pipeline,
    'name_confidence.png': name_confidence,
    'protection_level.png': protection_level,
    'parameter_threshold.jpg': lambda path: marker_parameters(path, 'threshold'),
    'parameter_search_radius.jpg': lambda path: marker_parameters(path, 'search_radius'),
    'parameter_edge_threshold.jpg': lambda path: runway_parameters(path, 'edge_threshold'),
    'parameter_opening_length.jpg': lambda path: runway_parameters(path, 'opening_length'),
    'parameter_peak_neighborhood.jpg': lambda path: runway_parameters(path, 'peak_neighborhood'),
    'parameter_rows.jpg': lambda path: runway_parameters(path, 'rows'),
}


def main() -> None:
    """Draw all of them, or those named."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / 'docs' / 'pictures'
    folder.mkdir(parents=True, exist_ok=True)
    for name in sys.argv[2:] or PICTURES:
        PICTURES[name](folder / name)
        print(f'{name}: {(folder / name).stat().st_size / 1000:.0f} kB')


if __name__ == '__main__':
    main()
