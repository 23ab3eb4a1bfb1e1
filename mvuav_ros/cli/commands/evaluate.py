"""``mvuav evaluate``: results against truth or labels, and the thesis's experiments."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Optional

import typer
from typer.core import TyperGroup

from mvuav_ros.cli import options
from mvuav_ros.cli.terminal import frame_progress, say
from mvuav_ros.parameters.declaration import ParameterError
from mvuav_ros.recordings.account import RecordingError, SourceError
from mvuav_ros.recordings.layout import SIMULATED
from mvuav_ros.recordings.remote import is_url, local_copy, write_whole

if TYPE_CHECKING:
    from mvuav_ros.offline.evaluation.corners import CornersScore
    from mvuav_ros.offline.evaluation.evaluation_run import EvaluationRun


def corners(
    labels: Path = typer.Argument(
        ..., metavar='CSV', help='The labels; the images are in the same folder.'
    ),
    params_file: options.ParamsFile = None,
    param: options.Param = None,
    horizon: Optional[Path] = typer.Option(
        None,
        help='CSV file with the horizon of each frame, instead of an attitude: columns file, '
        'row_at_centre (px) and slope_deg (right end down positive).',
    ),
    gray: bool = typer.Option(False, '--gray', help='Convert the images to grey first.'),
    tolerance: float = typer.Option(3.0, help='Horizontal error allowed, px.', min=0),
    tolerance_share: float = typer.Option(
        0.05, help='The same as a share of the near width; the larger one holds.', min=0
    ),
    as_json: options.Json = None,
    images: Optional[Path] = typer.Option(
        None, help='Folder for overlays: best, median, worst, each failure.'
    ),
    minimum: float = typer.Option(
        0.0,
        help='Exit with status 1 if both edges are found in fewer frames (share, 0 to 1).',
        min=0,
        max=1,
    ),
) -> None:
    """Say in how many frames both runway edges were found, and in how many they are wrong.

    The columns of CSV are file and near_left, near_right, far_right, far_left, each with _x and
    _y, px. An edge is right when a line with its role is within max(3 px, 5 % of the near
    width) of its corners. That is measured along the rows of both corners. Wrong are
    frames in which both edges were reported (so with at least min_confidence) and one is not
    right. Frames count from the 25th on; the first report is counted from the first frame. The mode
    is approach, as the thesis's scheme gives lines no roles.
    """
    from mvuav_ros.offline.evaluation import corners as work
    from mvuav_ros.parameters.parameter_file import resolve_parameters
    from mvuav_ros.parameters.runway_detector import RunwayDetectorParameters

    if as_json is not None:
        options.refuse_to_overwrite(as_json, True, inputs=(labels, horizon))
    given = resolve_parameters(['runway_detector'], params_file or (), param or ())
    values = {'mode': 'approach', **given['runway_detector']}
    parameters = RunwayDetectorParameters.from_mapping(values)
    if parameters.mode != 'approach':
        raise ParameterError(
            'mode', f'must be approach, as the lines of {parameters.mode} have no roles'
        )
    if horizon is not None and parameters.horizon_source == 'image':
        raise ParameterError('--horizon', 'has no effect with horizon_source image')
    frames, allowed = work.read_corners(labels), work.Tolerance(tolerance, tolerance_share)
    lines = None if horizon is None else work.read_horizon(horizon, frames)
    run = work.LabelledRun(labels.parent, frames, parameters, lines, gray, allowed)
    with frame_progress() as progress:
        task = progress.add_task('frames', total=len(frames))
        score = work.run_detector(run, lambda: progress.advance(task))
    if images is not None:
        work.write_images(run, score, images)
    _report(score)
    if not score.counted:
        raise SourceError(f'{labels}: no frame counts, as the first {work.WARM_UP} do not')
    if as_json is not None:
        write_whole(as_json, json.dumps(score.figures(), indent=2) + '\n')
    both = score.shares['both_found']
    if both < minimum:
        found = f'both edges were found in {100 * both:.1f} % of the frames'
        raise SourceError(f'{labels}: {found}, less than --minimum')


def _report(score: CornersScore) -> None:
    import numpy as np

    from mvuav_ros.offline.evaluation.corners import SHARES, WARM_UP

    say(f'frames counted {len(score.counted)} (from the {WARM_UP + 1}th)')
    for name, share in score.shares.items():
        say(f'{SHARES[name][0]} {100 * share:.1f} %')
    say(f'first report in frame {score.first_report or "none"}')
    errors = [frame.error for frame in score.counted if math.isfinite(frame.error)]
    if errors:
        median, high = np.percentile(errors, [50, 90])
        say(f'error / tolerance: median {median:.2f}, 90th percentile {high:.2f}')
    for name, count in sorted(score.failures.items()):
        say(f'failures {name} {count}')


Output = Annotated[Path, typer.Option('--output', '-o', help='Folder for the report.')]


class _BagByDefault(TyperGroup):
    """``mvuav evaluate flight.mcap`` means ``mvuav evaluate bag flight.mcap``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        if args and args[0] not in (*self.commands, '--help'):
            args = ['bag', *args]
        return super().parse_args(ctx, args)


evaluate = typer.Typer(
    help='Compare results with truth and write a report. `evaluate INPUT` is `evaluate bag INPUT`.',
    no_args_is_help=True,
    rich_markup_mode=None,
    cls=_BagByDefault,
)
evaluate.command()(corners)


@evaluate.command()
def thesis(
    output: Output = Path('out/thesis'),
    seed: int = typer.Option(2006, help='Seed of the synthetic flights.', min=0, max=2**31 - 1),
    jobs: int = typer.Option(2, help='Number of flights in parallel.', min=1),
    quick: bool = typer.Option(
        False, '--quick', help='Fewer flights: rough numbers in about a minute.'
    ),
    force: options.Force = False,
) -> None:
    """Make the tables and figures of the thesis's chapter 5 again, on synthetic flights.

    Leaves index.html, which needs no other file, and every table (CSV, JSON) and figure (PNG).
    """
    from mvuav_ros.offline.report import write_report
    from mvuav_thesis.build import build_report, steps_of
    from mvuav_thesis.plan import Plan

    options.take_folder(output, force)
    plan = Plan.quick(seed, jobs) if quick else Plan(seed=seed, jobs=jobs)
    with frame_progress() as progress:
        task = progress.add_task('flights', total=steps_of(plan))
        report, claims = build_report(plan, lambda: progress.advance(task), ' '.join(sys.argv[1:]))
    for claim in claims:
        say(f'{claim.verdict:>16}  {claim.statement}: {claim.ours}')
    say(write_report(report, output))


@evaluate.command()
def integrity(
    output: Output = Path('out/integrity'),
    frames: int = typer.Option(
        1_000_000, help='With faults at the stated priors; a tenth as many more often.', min=1
    ),
    factor: float = typer.Option(
        1000.0,
        help='How much more often, in the second run; at 5000 half of the lights are wrong.',
        min=1.0,
        max=5000.0,
    ),
    seed: int = typer.Option(0, help='Of the first flight.', min=0),
    jobs: int = typer.Option(2, help='Number of flights in parallel.', min=1),
    force: options.Force = False,
) -> None:
    """Hold the pose's protection levels against the truth of flights with injected faults.

    Flies bare lights of the built-in tanker, once with faults as frequent as the levels assume,
    and once far more often. Leaves index.html with counts and Stanford diagrams.
    """
    from mvuav_ros.offline.evaluation.protection import flights_of, protection_report, run
    from mvuav_ros.offline.report import write_report
    from mvuav_ros.vision.integrity import IntegrityBudget

    options.take_folder(output, force)
    budget, more = IntegrityBudget(), max(frames // 10, 1)
    with frame_progress() as progress:
        task = progress.add_task('flights', total=flights_of(frames) + flights_of(more))
        runs = [
            (often, run(budget, count, often, seed, jobs, lambda: progress.advance(task)))
            for often, count in ((1.0, frames), (factor, more))
        ]
    for often, counts in runs:
        say(
            f'faults {often:g} times as stated: {counts.misleading} of {counts.frames} frames '
            f'misleading (at most {counts.misleading_bound():.2g}, stated {often * budget.risk:g}),'
            f' {counts.silent} without levels, {counts.alerts} alerts'
        )
    say(write_report(protection_report(budget, runs, seed), output))


@evaluate.command()
@options.describes_run
def bag(
    source: str = typer.Argument(
        ..., metavar='INPUT', help="A bag with truth, or a flight such as 'sim:tanker?motion=roll'."
    ),
    output: Output = Path('out/evaluation'),
    replayed: bool = typer.Option(
        False,
        '--replay',
        help='Run the nodes even if the bag holds their results; what says how implies it.',
    ),
    param: options.Param = None,
    force: options.Force = False,
    **described: Any,
) -> None:
    """Compare the nodes' results in a bag with the bag's truth.

    Truth is /truth/markers, /truth/rpy, /truth/pose and /truth/lines, as `mvuav simulate` writes
    them. Where the bag has no results of any node, the nodes run on its images.
    """
    from mvuav_ros.offline.evaluation import evaluation_run as running
    from mvuav_ros.offline.evaluation.bag_report import bag_report
    from mvuav_ros.offline.evaluation.metrics import is_compared
    from mvuav_ros.offline.report import write_report

    is_simulated = source.startswith(SIMULATED)
    if not (is_simulated or is_url(source) or Path(source).expanduser().exists()):
        raise RecordingError(f'{source} does not exist')
    options.take_folder(output, force)
    run, how, asked = None, {'results': "the bag's own"}, options.RunOptions(**described)
    # One copy of what lies elsewhere, however often it is read.
    with local_copy(source) as path:
        if not (is_simulated or replayed or param or asked != options.RunOptions()):
            run = running.read_bag(path)
            _require_truth(run, source)
        if run is None or not run.results.stamps:
            settings = asked.settings(_nodes(str(path), param or ()), param or ())
            how = {'results': 'replayed by this version', **settings.described()}
            run = running.replay(str(path), settings)
            _require_truth(run, source)
    run.name = source
    if not is_compared(run):
        said = 'no result is of what its truth says; --replay runs the nodes of the truth'
        raise RecordingError('; '.join([f'{source}: {said}', *run.errors]))
    report = bag_report(run, how)
    numbers = next(table for table in report.tables() if table.key == 'metrics')
    for row in range(len(numbers.rows)):
        say(' '.join(numbers.text(row, column) for column in range(3)).rstrip())
    say(write_report(report, output))


def _nodes(source: str, assignments: Iterable[str]) -> list[str]:
    """Those that the truth can judge, and those whose parameters are given."""
    from mvuav_ros.offline.evaluation.evaluation_run import nodes_for
    from mvuav_ros.parameters.parameter_file import node_names, parse_assignment

    asked = [parse_assignment(assignment)[0] for assignment in assignments]
    return node_names(','.join([*nodes_for(source), *asked]))


def _require_truth(run: EvaluationRun, source: str) -> None:
    if not run.truth.stamps:
        how = 'mvuav simulate writes bags that do, and mvuav replay --keep-inputs keeps it'
        raise RecordingError(
            f'{source} holds no truth (/truth/markers, /truth/rpy, /truth/pose, /truth/lines); '
            + '; '.join([how, *run.errors])
        )
    if run.mismatch:
        raise RecordingError(f'{source}: {run.mismatch}')
