"""Which recordings a user names, which files make up one, and what each file is."""

from __future__ import annotations

import hashlib
import os
import re
import sys
from collections.abc import Iterator, Sequence
from glob import glob
from pathlib import Path

from mvuav_ros.recordings.account import Account, RecordingError, counted
from mvuav_ros.recordings.remote import is_url, reached

IMAGE_SUFFIXES = frozenset(
    {'.png', '.jpg', '.jpeg', '.bmp', '.tif', '.tiff', '.pgm', '.ppm', '.webp'}
)

_NEVER_BAGS = IMAGE_SUFFIXES | {'.yaml', '.txt', '.csv'}
_MAX_METADATA = 1 << 24
_ACCEPTED = 'a rosbag2 folder, a .mcap, a .db3 or a ROS 1 .bag file'
METADATA = 'metadata.yaml'


def recording_files(path: Path, account: Account) -> list[Path]:
    """The files of the recording at ``path`` in the order in which they were written.

    Raises:
        RecordingError: there is nothing, or nothing that looks like a recording.
    """
    try:
        if not path.exists():
            raise RecordingError(f'{path} does not exist; give {_ACCEPTED}')
        path = named_recording(path)
        if not path.is_dir():
            return [path]
        present = list(_bag_files(path))
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error.strerror or error}') from None
    if not present:
        raise RecordingError(f'{path} holds no recording (*.mcap, *.db3); give {_ACCEPTED}')
    listed = None
    if (path / METADATA).exists():
        listed = _listed_names(path / METADATA, account)
    else:
        account.note((path, METADATA), f'{path.name}: {METADATA} is missing')
    if listed is not None:
        return _chosen(present, listed, account)
    names = [entry.name for entry in present]
    if not _are_parts(names):
        said = f'{path} holds several recordings; give one of them: {", ".join(names)}'
        raise RecordingError(said)
    return present


def looks_like_bag(path: Path) -> bool:
    """Whether a path is a bag and not images; content decides where it is not damaged.

    Raises:
        RecordingError: it is a folder that cannot be read.
    """
    if not path.is_dir():
        return path.name == METADATA or is_bag_file(path)
    try:
        return (path / METADATA).exists() or any(_bag_files(path))
    except OSError as error:
        raise RecordingError(f'{path} cannot be read: {error.strerror or error}') from error


def named_recording(path: Path) -> Path:
    """The recording that a path names: a folder's ``metadata.yaml`` names the folder."""
    return path.parent if path.name == METADATA else path


def _listed_names(path: Path, account: Account) -> Sequence[str] | None:
    """The file names in metadata.yaml; None if it is damaged."""
    from mvuav_ros.parameters.yaml_text import read_yaml  # Few who ask what a file is need it

    try:
        if not path.is_file() or path.stat().st_size > _MAX_METADATA:
            raise ValueError('no file, or implausibly large')
        listed = read_yaml(path.read_text('utf-8'))['rosbag2_bagfile_information']
        names = listed['relative_file_paths']
        if names and all(isinstance(name, str) for name in names):
            files = listed.get('files')
            if not files and len(names) == 1:
                files = [{**listed, 'path': names[0]}]
            for file in files or ():
                if isinstance(file.get('message_count'), int):
                    account.promise(_plain(Path(file['path']).name), file['message_count'])
            return [Path(name).name for name in names]
    except Exception:  # beside YAMLError whatever its constructors stumble over
        pass
    account.note((path, METADATA), f'{path.parent.name}: {path.name} is damaged; not used')
    return None


def _chosen(present: list[Path], listed: Sequence[str], account: Account) -> list[Path]:
    by_name = {_plain(entry.name): entry for entry in reversed(present)}
    plain = dict.fromkeys(map(_plain, listed))
    chosen = [by_name[name] for name in plain if name in by_name]
    if missing := [name for name in listed if _plain(name) not in by_name]:
        names = ', '.join(missing[:3]) + (', …' if len(missing) > 3 else '')
        of = f'{len(missing)} of the {counted(len(listed), "file")} that {METADATA} lists'
        are = 'is' if len(missing) == 1 else 'are'
        lost = account.promised(map(_plain, missing))
        account.lose(METADATA, 'missing', f'{of} {are} missing: {names}', lost)
    series = {_part(name)[0] for name in listed}
    for entry in present:
        if _plain(entry.name) in plain:
            continue
        # After a crash, metadata.yaml may not know the last files of a split recording.
        if _part(entry.name)[0] in series:
            chosen.append(entry)
            account.note((entry, 'unlisted'), f'{entry.name}: not listed in {METADATA}, read')
        else:
            said = f'{entry.name}: not listed in {METADATA}, not read'
            account.lose(entry.name, 'unlisted', said)
    chosen.sort(key=natural_key)
    if not chosen:
        raise RecordingError(
            f'{present[0].parent} holds none of the files that its {METADATA} lists; '
            'give one of its files instead'
        )
    return chosen


def _plain(name: str) -> str:
    return name.removesuffix('.zstd').removesuffix('.active')


_PART = re.compile(r'(.*)_(\d+)(\.[^.]*)')
_ROS1_PART = re.compile(r'(.*?)(?:(?:^|_)\d{4}(?:-\d\d){5})?_(\d+)(\.bag)')


def _part(name: str) -> tuple[str, str]:
    """What the parts of a split recording share, and the number of this one; '' if it has none.

    Recorders end their names in _0, _1, and so on; ROS 1 puts the time of each part before that.
    """
    plain = plain_name(name)
    found = (_ROS1_PART if plain.endswith('.bag') else _PART).fullmatch(plain)
    return (found[1] + found[3], found[2]) if found else (plain, '')


def _are_parts(names: Sequence[str]) -> bool:
    """Whether files are named as the parts of one recording: alike, but for a number each."""
    parts = [_part(name) for name in names]
    return len(dict(parts)) == 1 and len(set(parts)) == len(parts)


def natural_key(file: Path) -> list[str | int]:
    """Sorts bag_10 behind bag_9, and one folder's files behind those of another."""
    parts: list[str | int] = [*re.split(r'(\d+)', str(file))]
    parts[1::2] = map(int, parts[1::2])
    return parts


MCAP_START = b'\x89MCAP0\r\n'
SQLITE_START = b'SQLite format 3\0'
ROS1_START = b'#ROSBAG V'
ZSTD_START = b'\x28\xb5\x2f\xfd'
BAG_SUFFIXES = ('.mcap', '.db3', '.bag')
"""After `plain_name`."""

_BAG_STARTS = (MCAP_START, SQLITE_START, ROS1_START, ZSTD_START)
# PNG, JPEG, TIFF, BMP, grey and colour PNM.
_IMAGE_STARTS = (b'\x89PNG', b'\xff\xd8\xff', b'II*\0', b'MM\0*', b'BM', b'P5\n', b'P6\n')
# AVI and WebP; Matroska; Ogg; Flash; MPEG.
_MEDIA_STARTS = (
    *_IMAGE_STARTS,
    *(b'RIFF', b'\x1a\x45\xdf\xa3', b'OggS', b'FLV', b'\0\0\1\xba', b'\0\0\1\xb3'),
)


def plain_name(name: str) -> str:
    """A file's name in small letters without what compression and a running recorder append."""
    name = name.lower()
    for ending in ('.zstd', '.zst', '.active'):
        name = name.removesuffix(ending)
    return name


def start_of(path: Path) -> bytes:
    """The first bytes of a regular file; nothing of a pipe or device, which would block.

    Raises:
        OSError: it cannot be read.
    """
    if not path.is_file():
        return b''
    with path.open('rb') as stream:
        return stream.read(16)


def is_image_start(start: bytes) -> bool:
    """Whether a file that begins so is an image."""
    return start.startswith(_IMAGE_STARTS) or (start[:4] == b'RIFF' and start[8:12] == b'WEBP')


def is_bag_file(path: Path) -> bool:
    """Whether a file is (part of) a recording, perhaps with damaged first bytes."""
    try:
        start = start_of(path)
    except OSError:
        start = b''
    if start.startswith(_BAG_STARTS):
        return True
    is_media = start.startswith(_MEDIA_STARTS) or start[4:8] == b'ftyp'
    return not is_media and plain_name(path.name).endswith(BAG_SUFFIXES)


VIDEO_SUFFIXES = frozenset(
    {'.mp4', '.avi', '.mov', '.mkv', '.webm', '.m4v', '.mpg', '.mpeg', '.ts', '.wmv', '.flv'}
)
_SUFFIXES = ('.zstd', '.zst', '.mcap', '.db3', '.bag')
_DATE = re.compile(r'\d{4}[-_]\d\d[-_]\d\d')


def recordings_in(source: str) -> list[str]:
    """What a path names: itself, or the recordings in a folder of them.

    A folder of images is one recording, and so is one with a rosbag2 ``metadata.yaml``. Without
    it files are the parts of one if all are named as rosbag2 and rosbag name parts: by the
    folder or by a date, and a number.
    """
    path = Path(source).expanduser()
    if is_url(source):
        return [source]
    if path.name == METADATA:
        return [str(named_recording(path))]
    if not path.is_dir() or _is_one(path):
        return [source]
    found = [entry for entry in entries(path) if _is_recording(entry)]
    return [str(Path(source) / entry.name) for entry in found] or [source]


SIMULATED = 'sim:'
"""What a synthetic flight in place of a recording begins with."""


def absolute_place(place: str) -> str:
    """What names the same in every folder; a slash at its end, which says folder, is kept."""
    if place.startswith(SIMULATED) or is_url(place):
        return place
    return f'{Path(place).expanduser().absolute()}{"/" if place.endswith("/") else ""}'


_MARKS = ('ETag', 'LastModified', 'created', 'mtime')
"""By which whatever fsspec reaches shows that a file is another one."""


def fingerprint(source: str) -> dict[str, str]:
    """The input's path, and a digest of the names, sizes and times of its files.

    Raises:
        RecordingError: fsspec is missing, or nothing can be read from there.
    """
    digest, total = hashlib.sha256(), 0
    if is_url(source):
        with reached(source, 'read') as (system, place):
            for name in sorted(system.find(place)):
                status = system.info(name)
                total += status['size'] or 0
                marks = [str(status.get(key)) for key in _MARKS]
                digest.update('\0'.join([name, str(status['size']), *marks]).encode())
    else:
        path = Path(source).expanduser()
        files = [path]
        if not path.is_file():
            files = [*path.iterdir()] if path.is_dir() else matching(path)
        for file in sorted(file for file in files if file.is_file()):
            local = file.stat()
            total += local.st_size
            digest.update(
                b'%s\0%d\0%d\n' % (os.fsencode(file.name), local.st_size, local.st_mtime_ns)
            )
        source = os.fsencode(path.resolve()).decode('utf-8', 'replace')
    return {'input': source, 'input_bytes': str(total), 'input_files': digest.hexdigest()}


def matching(pattern: Path) -> list[Path]:
    """What a glob names; a folder that exists is no pattern, whatever signs its name has."""
    folder = next(parent for parent in pattern.parents if parent.is_dir())
    names = glob(str(pattern.relative_to(folder)), root_dir=folder)  # noqa: PTH207
    return [folder / name for name in names]


def flight_name(source: str) -> str:
    """What a recording's results are called: its name without what says how it is stored."""
    if source.startswith(SIMULATED):
        return re.sub(r'[^\w.=-]+', '_', source.removeprefix(SIMULATED))
    named = source.split('?')[0] if is_url(source) else source
    path = named_recording(Path(named).expanduser())
    name = path.absolute().name
    if any(sign in name for sign in '*?[') and not path.exists():
        name = path.absolute().parent.name
    if path.is_dir():
        return name
    for suffix in _SUFFIXES:
        name = name.removesuffix(suffix)
    return name if path.suffix in _SUFFIXES else name.removesuffix(path.suffix)


def by_flight(sources: Sequence[str]) -> dict[str, str]:
    """Recordings by the names of their flights.

    Raises:
        RecordingError: two have the same name.
    """
    flights: dict[str, str] = {}
    for source in sources:
        name = flight_name(source)
        if name in flights:
            raise RecordingError(
                f'{flights[name]} and {source} would both become {name}; '
                'take them one after the other, into folders of their own'
            )
        flights[name] = source
    return flights


def entries(folder: Path) -> list[Path]:
    """What is in a folder, in its natural order; of a file that is also there compressed only one.

    Hidden files, as macOS leaves them beside each file (``._1.png``), are left out.
    """
    shown = [entry for entry in folder.iterdir() if not entry.name.startswith('.')]
    twins = {f'{entry.name}.zstd' for entry in shown}
    return sorted((e for e in shown if e.name not in twins), key=natural_key)


def _bag_files(folder: Path) -> Iterator[Path]:
    for entry in entries(folder):
        if entry.suffix.lower() not in _NEVER_BAGS and is_bag_file(entry):
            yield entry


def _is_recording(entry: Path) -> bool:
    if entry.is_dir():
        return _is_one(entry)
    return is_bag_file(entry) or entry.suffix.lower() in VIDEO_SUFFIXES


def _is_one(folder: Path) -> bool:
    try:
        inside = entries(folder)
    except OSError:
        return False
    if METADATA in [entry.name for entry in inside]:
        return True
    files = [entry for entry in inside if entry.is_file()]
    found = [file for file in files if _is_recording(file)]
    if not found:
        return any(entry.suffix.lower() in IMAGE_SUFFIXES for entry in files)
    bags = [file.name for file in found if is_bag_file(file)]
    if len(bags) == 1:
        return len(found) == 1 and not any((entry / METADATA).exists() for entry in inside)
    if not (_are_parts(bags) and all(_part(bag)[1] for bag in bags)):
        return False
    named = Path(_part(bags[0])[0]).stem == folder.absolute().name.lower()
    return named or bool(_DATE.search(bags[0]))


def shipped_folder(name: str) -> Path | None:
    """The folder ``config`` or ``bags``; None where it is not installed."""
    package = Path(__file__).resolve().parent.parent
    # colcon: install/mvuav_ros/lib/python3.x/site-packages/mvuav_ros
    shares = [Path(sys.prefix), *package.parents]
    places = [package.parent / name, *(base / 'share' / 'mvuav_ros' / name for base in shares)]
    return next((place for place in places if place.is_dir()), None)
