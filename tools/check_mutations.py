"""Breaks behaviours on purpose, one at a time, and lists which tests notice it.

Usage: check_mutations.py [NAME...]. Works on a copy; exit status 1 where a mutation survives.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
COPIED = ('mvuav_ros', 'test', 'config', 'bags', 'pyproject.toml')
MAX_LISTED = 4


class Mutation(NamedTuple):
    """One wrong line instead of a right one, and the tests that ought to notice it."""

    name: str
    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]


MARKERS = 'mvuav_ros/vision/markers'
RUNWAY = 'mvuav_ros/vision/runway'
MUTATIONS = (
    Mutation(
        'sign of roll',
        f'{MARKERS}/marker_results.py',
        'math.atan2(right.y - left.y, right.x - left.x)',
        'math.atan2(left.y - right.y, right.x - left.x)',
        ('test/vision/markers/test_reference.py', 'test/vision/markers/test_thesis_tracker.py'),
    ),
    Mutation(
        'strict threshold',
        'mvuav_ros/vision/point_operations.py',
        'cv2.threshold(gray, limit, 255',
        'cv2.threshold(gray, limit - 1, 255',
        ('test/vision/test_point_operations.py', 'test/vision/markers/test_reference.py'),
    ),
    Mutation(
        'order of peaks',
        f'{RUNWAY}/peaks.py',
        'divmod(int(accumulator.argmax()), cells)',
        'divmod(accumulator.size - 1 - int(accumulator.ravel()[::-1].argmax()), cells)',
        ('test/vision/runway/test_peaks.py', 'test/vision/runway/test_reference.py'),
    ),
    Mutation(
        "correction's OR",
        f'{RUNWAY}/correction.py',
        'line is None or rho_flag or theta_flag',
        'line is None or (rho_flag and theta_flag)',
        ('test/vision/runway/test_correction.py',),
    ),
    Mutation(
        'window clipping',
        f'{MARKERS}/marker_results.py',
        'x1 if x1 < right else right',
        'x1',
        ('test/vision/markers/test_thesis_tracker.py',),
    ),
    Mutation(
        'duplicate stamp',
        'mvuav_ros/processing/processor.py',
        'if frame.stamp_ns == last:',
        'if frame.stamp_ns == last and last is None:',
        ('test/processing/test_processor.py',),
    ),
    Mutation(
        'CDR padding',
        'mvuav_ros/messages/cdr.py',
        'data += bytes(_SIZES[layout[-1]] - excess)',
        'data += bytes(excess)',
        ('test/messages',),
    ),
    Mutation(
        'index order of the Hough grid',
        f'{RUNWAY}/hough.py',
        'self._column_starts = np.arange(self.theta.size) * self.shape[1]',
        'self._column_starts = np.arange(self.theta.size)[::-1] * self.shape[1]',
        ('test/vision/runway/test_hough.py', 'test/vision/runway/test_reference.py'),
    ),
    Mutation(
        'label order',
        f'{MARKERS}/thesis_tracker.py',
        'return left_wing, left_stabilizer, rudder, right_stabilizer, right_wing',
        'return left_wing, right_stabilizer, rudder, left_stabilizer, right_wing',
        ('test/vision/markers/test_reference.py',),
    ),
    Mutation(
        'a swapped camera axis',
        'mvuav_ros/vision/frames.py',
        '[(0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)]',
        '[(0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)]',
        ('test/vision/test_pose.py', 'test/simulation/test_pinhole.py'),
    ),
)


def caught_by(mutation: Mutation) -> list[str]:
    """The tests that fail with the mutation, `MAX_LISTED` at most.

    Raises:
        SystemExit: the right line is not in the file exactly once.
    """
    with tempfile.TemporaryDirectory() as folder:
        for name in COPIED:
            source, copy = ROOT / name, Path(folder, name)
            if source.is_dir():
                shutil.copytree(source, copy, ignore=shutil.ignore_patterns('__pycache__'))
            else:
                shutil.copy(source, copy)
        path = Path(folder, mutation.file)
        text = path.read_text()
        if text.count(mutation.right) != 1:
            raise SystemExit(f'{mutation.name}: not one such line in {mutation.file}')
        path.write_text(text.replace(mutation.right, mutation.wrong))
        command = [sys.executable, '-m', 'pytest', '-q', '-rf', '-p', 'no:cacheprovider']
        command += ['-m', '', f'--maxfail={MAX_LISTED}', *mutation.tests]
        run = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    lines = run.stdout.splitlines()
    return [line.split()[1] for line in lines if line.startswith(('FAILED', 'ERROR'))]


def main() -> int:
    """Try the mutations that the command line names, or all."""
    survived = 0
    for mutation in MUTATIONS:
        if len(sys.argv) > 1 and mutation.name not in sys.argv[1:]:
            continue
        tests = caught_by(mutation)
        survived += not tests
        print(f'{mutation.name}: {"caught by" if tests else "SURVIVED"}', flush=True)
        for test in tests:
            print(f'    {test}')
    return 1 if survived else 0


if __name__ == '__main__':
    sys.exit(main())
