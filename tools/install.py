"""Builds a virtual environment: install.py FOLDER EXTRA,... or install.py FOLDER FILE.txt.

With extras it holds this package with the thesis's experiments and their dependencies, in the
versions that were tested; with a
file of requirements just those.
Installs with uv, which takes a fraction of pip's time, from wherever pip is configured to
install from (index, mirror, proxy, certificates); with pip itself where uv cannot be had.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import threading
import time
from ast import literal_eval
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CONSTRAINTS = ROOT / 'requirements' / 'tested.txt'
OPTIONS = {
    'index-url': '--default-index',
    'extra-index-url': '--index',
    'find-links': '--find-links',
    'trusted-host': '--allow-insecure-host',
    'constraint': '--constraints',
}
"""pip's settings and uv's options for the same; any of them may hold several values."""
STRATEGIES = ('first-index', 'unsafe-first-match')
"""A package comes from the first index that has it; only where that one lacks the version that was
tested, as a mirror of a part does, from the next. Never from the one with the highest version:
somebody could put one there under a name of ours.
"""
VARIABLES = {'cert': 'SSL_CERT_FILE', 'client-cert': 'SSL_CLIENT_CERT', 'proxy': 'ALL_PROXY'}
"""pip's settings and the environment variables that uv reads."""
_ORDER = ('global', 'install', ':env:')
"""Where pip's settings come from; later ones win."""


def main() -> None:
    """Build or complete the environment that the command line names."""
    folder = ROOT / sys.argv[1]
    wanted = sys.argv[2]
    python = folder / 'bin' / 'python'
    if not python.exists():
        _run(f'building {folder.name}', [sys.executable, '-m', 'venv', str(folder)])
    # A module that was moved or deleted would be installed from here for ever.
    shutil.rmtree(ROOT / 'build' / 'lib', ignore_errors=True)
    if wanted.endswith('.txt'):
        what = ['--requirement', str(ROOT / wanted)]
    else:
        what = ['--constraint', str(CONSTRAINTS), f'{ROOT}[{wanted}]', f'{ROOT}/mvuav_thesis']
    done = install(python, f'installing {wanted} into {folder.name}', what)
    # Within the package, where linters and tests would find it.
    shutil.rmtree(ROOT / 'mvuav_thesis' / 'build', ignore_errors=True)
    if not done:
        sys.exit(1)


def install(python: Path, title: str, what: Sequence[str]) -> bool:
    """Install packages into an environment.

    Args:
        python: the environment's.
        title: what the progress line says.
        what: requirements and options that pip and uv share.

    Returns:
        Whether it succeeded; reasons are on stderr.
    """
    uv = python.parent / 'uv'
    pip = [str(python), '-m', 'pip', '--disable-pip-version-check']
    if not uv.exists():
        fetch = [*pip, 'install', '--constraint', str(CONSTRAINTS), 'uv']
        _run('fetching the installer', fetch, quiet=True)
    if uv.exists():
        options, variables = uv_settings(pip_settings(pip))
        command = [str(uv), 'pip', 'install', '--python', str(python)]
        # Our own packages are built anew each time: their version does not change with the files.
        command += ['--reinstall-package', 'mvuav_ros', '--reinstall-package', 'mvuav_thesis']
        command += [*options, *what]
        for strategy in STRATEGIES:
            # Where one index lacks a version, another one may have it: that is no failure yet.
            last = strategy == STRATEGIES[-1]
            tried = [*command, '--index-strategy', strategy]
            if _run(title, tried, variables, quiet=True, silent=not last):
                return True
        print('uv could not; trying pip', file=sys.stderr)
    return _run(title, [*pip, 'install', *what])


def pip_settings(pip: Sequence[str]) -> dict[str, str]:
    """What pip is configured with, in files and variables; more particular settings win."""
    listed = subprocess.run([*pip, 'config', 'list'], capture_output=True, text=True).stdout
    settings: dict[str, str] = {}
    for line in sorted(listed.splitlines(), key=lambda line: _ORDER.index(line.split('.')[0])):
        name, sign, value = line.partition('=')
        if sign:
            settings[name.rpartition('.')[2]] = str(literal_eval(value))
    return settings


def uv_settings(settings: dict[str, str]) -> tuple[list[str], dict[str, str]]:
    """What pip is configured with, as options and environment variables of uv."""
    options: list[str] = []
    for name, option in OPTIONS.items():
        for value in shlex.split(settings.get(name, '')):
            options += [option, value]
    if settings.get('no-index', '').lower() in ('1', 'true', 'yes', 'on'):
        options.append('--no-index')
    variables = {VARIABLES[name]: settings[name] for name in VARIABLES if settings.get(name)}
    return options, variables


def _run(
    title: str,
    command: Sequence[str],
    variables: dict[str, str] | None = None,
    *,
    quiet: bool = False,
    silent: bool = False,
) -> bool:
    """Run a command silently but for one line that says how long.

    If it fails its output is shown: all, the end of it (``quiet``), or nothing (``silent``).
    """
    started, done = time.monotonic(), threading.Event()
    live = sys.stderr.isatty()

    def tell() -> None:
        while not done.wait(0.5):
            print(f'\r{title} … {time.monotonic() - started:.0f} s', end='', file=sys.stderr)

    teller = threading.Thread(target=tell, daemon=True)
    if live:
        teller.start()
    run = subprocess.run(
        command, env={**os.environ, **(variables or {})}, capture_output=True, text=True
    )
    done.set()
    if live:
        teller.join()
    start = '\r' if live else ''
    if silent and run.returncode != 0:
        return False
    print(f'{start}{title}: {time.monotonic() - started:.0f} s', file=sys.stderr, flush=True)
    if run.returncode != 0:
        lines = (run.stdout + run.stderr).strip().splitlines()
        print('\n'.join(lines[-3:] if quiet else lines), file=sys.stderr)
    return run.returncode == 0


if __name__ == '__main__':
    main()
