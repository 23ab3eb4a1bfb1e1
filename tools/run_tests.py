"""Runs all parts of the tests even if one fails, with one verdict at the end.

Parts that mostly wait (live nodes, the browser) run beside those that compute.

Usage: run_tests.py test|fast|rest|all|footage|robot (see the Makefile).
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
BIN = ROOT / '.venv' / 'bin'
PYTHONS = ('3.11', '3.12', '3.13')
TUTORIALS = 'docs/test_tutorials.py'
WITH_GRAPH = ('nodes', 'cli/demo', 'panel', TUTORIALS)
LIBRARY = ('vision', 'parameters', 'messages', 'processing', 'simulation', 'package')
DOCTESTS = ['mvuav_ros/__init__.py', 'mvuav_ros/vision', 'mvuav_ros/parameters']
QUICK = [
    *('test/vision', 'test/parameters', 'test/messages', 'test/processing', 'test/recordings'),
    *('test/sources', 'test/package'),
]
MAX_TEST_SECONDS = 30 * 60.0  # of a part of `make test`: five times what it takes on two cores
NICE = '3'  # of parts that yield to those beside them
MAX_ENDING_SECONDS = 30.0  # in which a part that is interrupted says what it was at
_BOOTSTRAPPED = '_ROS_WHEELS_BOOTSTRAP_COMPLETE'
# With these pytest prints the difference of two images whole, which takes an hour.
_TOLD_BY_CI = ('CI', 'BUILD_NUMBER')
_running: set[subprocess.Popen[str]] = set()
_ending = threading.Event()
_COUNT = re.compile(r'(\d+) (passed|failed|skipped|error)')
_FAILURE = re.compile(r'(FAILED|ERROR|E) +\S')
MAX_KEPT_LINES = 1000  # of a command's output, in which its failures are looked for
MAX_FAILURE_LINES = 20  # of a command, repeated below the summary


class Part(NamedTuple):
    """Commands that run one after the other; ``counts`` is told from pytest's last lines."""

    name: str
    commands: Callable[[], list[list[str]]]
    max_seconds: float | None = None  # after which each command is ended, and has failed
    yields: bool = False  # to parts beside it, as nothing in it waits for an answer


class Outcome(NamedTuple):
    """What became of a part."""

    name: str
    passed: int
    failed: int
    skipped: int
    seconds: float
    note: str = ''
    failures: Sequence[str] = ()


def pytest(*arguments: str, python: Path = BIN / 'python') -> list[str]:
    """A run of pytest; every skip is told with its reason, and the slowest tests.

    A test that takes five minutes tells where it is.
    """
    told = ('-q', '-rfEs', '--durations=25', '-o', 'faulthandler_timeout=300')
    return [str(python), '-m', 'pytest', *told, *arguments]


def parallel(*arguments: str, python: Path = BIN / 'python') -> list[str]:
    """A run of pytest on all cores; a file stays together, so that its flights are flown once."""
    return pytest('-n', 'auto', '--dist', 'loadfile', *arguments, python=python)


def lint() -> list[list[str]]:
    """codespell, the prose rules, ruff, mypy and import-linter."""
    return [
        [str(BIN / 'codespell')],
        [str(BIN / 'python'), 'tools/check_prose.py'],
        [str(BIN / 'ruff'), 'check', '--quiet', '.'],
        [str(BIN / 'ruff'), 'format', '--quiet', '--check', '.'],
        [str(BIN / 'mypy'), '--no-error-summary'],
        [str(BIN / 'lint-imports')],
    ]


def all_but(*folders: str) -> list[str]:
    """Arguments for the tests outside of some folders and of those on real footage."""
    return ['test', *(f'--ignore=test/{name}' for name in ('footage', *folders))]


def library() -> list[list[str]]:
    """The vision library, the simulation, the package itself."""
    return [parallel('-m', 'not long', *(f'test/{name}' for name in LIBRARY))]


def commands() -> list[list[str]]:
    """Recordings, replay, evaluation, reports and whatever else needs no ROS graph."""
    return [parallel('-m', 'not long', *all_but(*LIBRARY, *WITH_GRAPH))]


def quick() -> list[list[str]]:
    """What a developer waits for."""
    return [parallel('-m', 'not long', *QUICK)]


def doctests() -> list[list[str]]:
    """The examples in docstrings."""
    return [pytest('--doctest-modules', *DOCTESTS)]


def nodes() -> list[list[str]]:
    """Live nodes on real DDS, each test in a domain of its own; two at a time, as they wait."""
    return [pytest('-n', '2', '--dist', 'loadfile', '-m', 'not long', 'test/nodes')]


def tutorials() -> list[list[str]]:
    """The quick start and the tutorials, as printed; a page begins many commands and waits much."""
    return [pytest('-n', '2', '--dist', 'worksteal', f'test/{TUTORIALS}')]


def demo_and_panel() -> list[list[str]]:
    """What has a browser or a whole demo in it."""
    return [pytest('-m', 'not long', 'test/cli/demo', 'test/panel')]


def longest() -> list[list[str]]:
    """Fuzzing, interruptions by the hundred, soaks, long simulations, colcon."""
    return [pytest('-n', '2', '--dist', 'worksteal', '-m', 'long', 'test')]


def footage() -> list[list[str]]:
    """Real flights, roads and recordings."""
    return [parallel('test/footage')]


def find_python(version: str) -> Path | None:
    """A Python of that version on this machine: on the path, or one of pyenv's."""
    candidates = [shutil.which(f'python{version}')]
    pyenv = Path(os.environ.get('PYENV_ROOT', Path.home() / '.pyenv')) / 'versions'
    candidates += [str(path / 'bin' / 'python3') for path in sorted(pyenv.glob(f'{version}*'))]
    for candidate in filter(None, candidates):
        told = subprocess.run([candidate, '--version'], capture_output=True, text=True)
        if told.stdout.startswith(f'Python {version}.'):
            return Path(candidate)
    return None


def other_python(version: str) -> list[list[str]]:
    """The part without a graph on another Python."""
    python = find_python(version)
    if python is None:
        return []
    folder = f'.venv-{version}'
    tests = parallel(
        *('-m', 'not long', *all_but('package', 'docs/test_site.py', *WITH_GRAPH)),
        python=ROOT / folder / 'bin' / 'python',
    )
    return [[str(python), 'tools/install.py', folder, 'ros,dask,remote,parquet,test'], tests]


def robot() -> list[list[str]]:
    """Library and nodes with apt's NumPy, OpenCV and SciPy of Ubuntu 24.04, on its Python 3.12."""
    python = find_python('3.12')
    if python is None:
        return []
    inside = ROOT / '.venv-robot' / 'bin' / 'python'
    command = ('test/cli/commands', 'test/cli/bench', 'test/cli/test_app.py')
    tests = (*QUICK[:-1], *command)
    library = parallel('-m', 'not long', *tests, python=inside)
    live = pytest('-n', '2', '--dist', 'worksteal', '-m', 'not long', 'test/nodes', python=inside)
    install = [str(python), 'tools/install.py', '.venv-robot', 'requirements/robot.txt']
    return [install, library, live]


def stages(which: str) -> list[list[list[Part]]]:
    """A target of the Makefile: stage after stage, each of lanes side by side, each of parts."""
    here = f'{sys.version_info.major}.{sys.version_info.minor}'
    style, examples = Part('lint and types', lint), Part("docstrings' examples", doctests)
    others = [
        Part(f'Python {version}', lambda version=version: other_python(version))
        for version in PYTHONS
        if version != here
    ]
    of_a_robot = Part("a robot's libraries", robot)
    test = [
        [
            [Part('library', library, yields=True), examples],
            [Part('commands', commands, yields=True)],
            [Part('live nodes', nodes)],
            [Part('tutorials', tutorials)],
            [style, Part('demo and panel', demo_and_panel)],
        ]
    ]
    test = [
        [[part._replace(max_seconds=MAX_TEST_SECONDS) for part in lane] for lane in lanes]
        for lanes in test
    ]
    rest = [[[Part('the longest', longest), *others, of_a_robot]]]
    return {
        'test': test,
        'fast': [[[style, Part('quick tests', quick), examples]]],
        'rest': rest,
        'all': test + rest,
        'footage': [[[Part('real footage', footage)]]],
        'robot': [[[of_a_robot]]],
    }[which]


def run(part: Part) -> Outcome:
    """Run a part to its end, passing its output on with its name before each line."""
    started = time.monotonic()
    counts = {'passed': 0, 'failed': 0, 'skipped': 0, 'error': 0}
    failures: list[str] = []
    commands = part.commands()
    if not commands:
        return Outcome(part.name, 0, 0, 1, 0.0, 'not checked: no such Python on this machine')
    for command in commands:
        status, lines = _pass_on(part, command)
        last = lines[-1] if lines else ''
        found = {word: int(number) for number, word in _COUNT.findall(last)}
        if status != 0:
            named = [line for line in lines if _FAILURE.match(line)]
            failures += named[-MAX_FAILURE_LINES:] or [f'{" ".join(command)}: {last}']
        for word, number in found.items():
            counts[word] += number
        if not found:
            counts['passed' if status == 0 else 'failed'] += 1
        elif status != 0 and not (found.get('failed') or found.get('error')):
            counts['failed'] += 1
        if status != 0 and 'tools/install.py' in command:
            break
    failed = counts['failed'] + counts['error']
    seconds = time.monotonic() - started
    return Outcome(
        part.name, counts['passed'], failed, counts['skipped'], seconds, failures=failures
    )


def run_lanes(lanes: Sequence[Sequence[Part]]) -> list[Outcome]:
    """Run lanes of parts side by side; the outcomes in the parts' order."""
    with ThreadPoolExecutor(len(lanes)) as pool:
        futures = [pool.submit(lambda lane: [run(part) for part in lane], lane) for lane in lanes]
        try:
            return [outcome for future in futures for outcome in future.result()]
        except BaseException:
            _ending.set()
            for process in list(_running):
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGINT)
            raise


def environment() -> dict[str, str]:
    """Ours without what says that this is CI, and what the wheels of ROS set for this Python alone.

    They start an interpreter a second time with the path of its own libraries, and mark that in the
    environment: another Python would take these libraries for its own.
    """
    left_out = (_BOOTSTRAPPED, *_TOLD_BY_CI)
    kept = {name: value for name, value in os.environ.items() if name not in left_out}
    own = str(BIN.parent)
    paths = [
        path
        for path in kept.pop('LD_LIBRARY_PATH', '').split(os.pathsep)
        if path and not path.startswith(own)
    ]
    return kept | ({'LD_LIBRARY_PATH': os.pathsep.join(paths)} if paths else {})


def _pass_on(part: Part, command: Sequence[str]) -> tuple[int, Sequence[str]]:
    """A command's exit status and its last lines, everything shown as it comes."""
    lines: deque[str] = deque(maxlen=MAX_KEPT_LINES)
    if _ending.is_set():
        return 1, lines
    with subprocess.Popen(
        ['nice', '-n', NICE, *command] if part.yields else command,
        cwd=ROOT,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        # Ends with all of its children; and Linux shares the cores among sessions first, so that
        # busy neighbours of this terminal do not starve the tests.
        start_new_session=True,
    ) as process:
        _running.add(process)
        if part.yields:
            # Among sessions Linux goes by this instead, where it has it.
            with suppress(OSError):
                Path(f'/proc/{process.pid}/autogroup').write_text(NICE)
        timers = _end_after(process, part.max_seconds) if part.max_seconds else []
        assert process.stdout is not None
        for line in process.stdout:
            # In one piece: another lane may write meanwhile.
            sys.stdout.write(f'{part.name} | {line.rstrip()}\n')
            sys.stdout.flush()
            if line.strip():
                lines.append(line.strip())
    for timer in timers:
        timer.cancel()
    _running.discard(process)
    return process.returncode, lines


def _end_after(process: subprocess.Popen[str], seconds: float) -> list[threading.Timer]:
    """Interrupt a command and all that it started, and kill them if that does not end them."""

    def end(number: signal.Signals) -> None:
        print(f'{process.args} is ended: {number.name}, as it did not end in {seconds:.0f} s')
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)

    timers = [
        threading.Timer(seconds, end, (signal.SIGINT,)),
        threading.Timer(seconds + MAX_ENDING_SECONDS, end, (signal.SIGKILL,)),
    ]
    for timer in timers:
        timer.daemon = True
        timer.start()
    return timers


def summarize(outcomes: Sequence[Outcome]) -> int:
    """Print the table and the one line at its end; the exit status."""
    print('\n== summary')
    for outcome in outcomes:
        print(
            f'{outcome.name:24}{outcome.passed:6} passed{outcome.failed:5} failed'
            f'{outcome.skipped:5} skipped{outcome.seconds:7.0f} s  {outcome.note}'
        )
    # Here again: of a long output the end is what is kept.
    for outcome in outcomes:
        for line in outcome.failures:
            print(f'{outcome.name} | {line}')
    passed, failed, skipped = (
        sum(column) for column in zip(*(o[1:4] for o in outcomes), strict=True)
    )
    print(f'{passed} passed, {failed} failed, {skipped} skipped')
    return 1 if failed else 0


def main() -> int:
    """Run what the command line names."""
    which = sys.argv[1] if len(sys.argv) > 1 else 'test'
    # SIGINT as well: a shell's background jobs ignore it, and so would all that they start.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    try:
        outcomes = [outcome for lanes in stages(which) for outcome in run_lanes(lanes)]
    except KeyboardInterrupt:
        print('\ninterrupted', file=sys.stderr)
        return 130
    if which in ('test', 'all'):
        print('\nReal footage was not looked at: make test-footage FOOTAGE=FOLDER does that.')
    return summarize(outcomes)


if __name__ == '__main__':
    sys.exit(main())
