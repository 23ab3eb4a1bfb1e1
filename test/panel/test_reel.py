"""A recording frame by frame, with any values, as the node itself would see it."""

import asyncio
import tempfile
import time
from dataclasses import replace
from itertools import islice
from multiprocessing import active_children
from pathlib import Path

import numpy as np
import pytest
import zstandard
from support.graph import ROOT

pytest.importorskip('nicegui', reason='the extra panel is not installed')

from mvuav_ros.offline.stopping import Stop
from mvuav_ros.panel import reel
from mvuav_ros.panel.reel import Reel, ReelFailedError, ReelProcess, Wanted
from mvuav_ros.parameters.marker_tracker import MarkerTrackerParameters
from mvuav_ros.recordings import reading
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.source import SourceError

TANKER = str(ROOT / 'bags' / 'tanker.mcap')
VALUES = MarkerTrackerParameters().as_dict()
FIRST = Wanted(TANKER, 0.0, 'marker_tracker', 0, (VALUES,))


def show(player, index, *more, **changed):
    wanted = replace(FIRST, index=index, values=(VALUES, *more), **changed)
    return player(wanted, lambda _: None, Stop())


def figure(result, name):
    return next(float(f[1].rstrip('°m ')) for f in result.said['figures'] if f[0] == name)


def test_a_frame_that_is_jumped_to_is_as_if_all_before_had_been_seen():
    jumped, stepped = Reel(), Reel()
    for index in range(61):
        shown = show(stepped, index)
    there = show(jumped, 60)
    assert (there.count, there.is_whole) == (180, True) and there.seconds == pytest.approx(4.0)
    for name in ('roll', 'ahead', 'pitch'):
        left, right = (figure(s.results[0], name) for s in (shown, there))
        assert left == pytest.approx(right, abs=0.11)
    assert there.results[0].said['trust'] == ('good', '5 of 5 lights, protection level 0.5 m')
    assert there.results[0].jpeg[:2] == b'\xff\xd8'


def test_a_light_that_is_out_is_predicted_and_doubted():
    # The flight's left stabilizer is out from 8 s to 8.3 s.
    result = show(Reel(), 122).results[0]
    words = '4 of 5 lights, 1 predicted, protection level 0.5 m'
    assert result.said['trust'] == ('doubtful', words)


def test_two_sets_on_one_frame_and_a_value_that_is_changed():
    player = Reel()
    blind = {**VALUES, 'threshold': 0.99, 'mode': 'detect'}
    shown = show(player, 30, blind)
    assert [result.said['trust'][0] for result in shown.results] == ['good', 'bad']
    again = show(player, 30, VALUES)
    assert [result.said['trust'][0] for result in again.results] == ['good', 'good']
    assert again.results[0] is shown.results[0], 'what has not changed is not processed again'
    refused = show(player, 30, {**VALUES, 'threshold': 7.0}).results[1]
    assert 'threshold' in refused.reason and not refused.jpeg


def test_going_back_and_on_gives_the_same_again():
    player = Reel()
    forth = show(player, 40)
    show(player, 39)
    back = show(player, 40)
    (state, words), (state_before, words_before) = (
        shown.results[0].said['trust'] for shown in (back, forth)
    )
    assert (state, words.split(',')[0]) == (state_before, words_before.split(',')[0])
    # The level follows the noise that was learnt, which begins anew.
    level, level_before = (float(each.split()[-2]) for each in (words, words_before))
    assert level == pytest.approx(level_before, rel=0.2)
    assert figure(back.results[0], 'roll') == pytest.approx(
        figure(forth.results[0], 'roll'), abs=0.1
    )
    assert show(player, 10_000).index == 179 and show(player, -5).index == 0


def test_of_a_recording_too_long_for_memory_a_stretch_is_shown(monkeypatch):
    monkeypatch.setattr(reel, 'MAX_BYTES', 640 * 480 * 10)
    shown = show(Reel(), 500)
    assert (shown.count, shown.index, shown.is_whole) == (10, 9, False)
    later = show(Reel(), 0, start_s=4.0)
    assert later.count == 10 and not later.is_whole
    first, fifth = (show(Reel(), 0, start_s=s).results[0] for s in (0.0, 4.0))
    assert not np.array_equal(first.jpeg, fifth.jpeg)


def test_the_time_of_a_frame_counts_from_the_recordings_first_message_as_its_start_does(tmp_path):
    path = tmp_path / 'late.mcap'
    writer = RecordingWriter(path)
    with open_recording(TANKER) as recording:
        for number, message in enumerate(islice(recording.messages({'/image_raw'}), 60)):
            begun = message.stamp_ns + 2_000_000_000
            if number == 0:
                writer.write(
                    '/note', 'std_msgs/msg/String', message.stamp_ns, b'\0\1\0\0' + bytes(8)
                )
            # The stamps of the images are those of another clock.
            writer.write('/image_raw', message.type, begun, message.data)
    writer.close()
    player = Reel()
    for start_s, index, seconds in ((0.0, 0, 2.0), (0.0, 15, 3.0), (4.0, 0, 4.0), (4.0, 15, 5.0)):
        shown = show(player, index, source=str(path), start_s=start_s)
        assert shown.seconds == pytest.approx(seconds, abs=0.01)
        assert shown.is_whole == (start_s == 0.0)
    with pytest.raises(SourceError, match=r'is 5\.93 s long: the start at 60 s'):
        show(player, 0, source=str(path), start_s=60.0)


def test_what_could_not_be_read_is_said(tmp_path):
    cut, whole = tmp_path / 'cut.mcap', Path(TANKER).read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    shown = show(Reel(), 0, source=str(cut))
    assert 0 < shown.count < 180 and 'cut off' in shown.lost
    assert show(Reel(), 0).lost == ''


def test_a_compressed_recording_is_unpacked_once(tmp_path, monkeypatch):
    packed, unpacked = tmp_path / 'tanker.mcap.zstd', []
    packed.write_bytes(zstandard.compress(Path(TANKER).read_bytes()))
    unpack = reading.decompress_file

    def count(*arguments):
        unpacked.append(arguments)
        return unpack(*arguments)

    monkeypatch.setattr(reading, 'decompress_file', count)
    scratch = tmp_path / 'scratch'
    scratch.mkdir()
    monkeypatch.setattr(tempfile, 'tempdir', str(scratch))
    player = Reel()
    assert show(player, 0, source=str(packed)).count == 180
    assert len(unpacked) == 1 and not list(scratch.iterdir())


def test_of_a_recording_with_several_cameras_the_images_of_each_can_be_shown(tmp_path):
    path = tmp_path / 'two.mcap'
    writer = RecordingWriter(path)
    for name, frames in (('runway', 3), ('tanker', 2)):
        with open_recording(ROOT / 'bags' / f'{name}.mcap') as recording:
            for message in islice(recording.messages({'/image_raw'}), frames):
                writer.write(f'/{name}/image_raw', message.type, message.stamp_ns, message.data)
    writer.close()
    both = ('/runway/image_raw', '/tanker/image_raw')
    player, images = Reel(), {}
    for topic, shown_topic, count in (
        ('/elsewhere', both[0], 3),
        (both[1], both[1], 2),
        ('/elsewhere', both[1], 2),
        (both[0], both[0], 3),
    ):
        shown = show(player, 0, source=str(path), topics=(topic, '', ''))
        used, there = shown.topics[0]
        assert (used, shown.count) == (shown_topic, count)
        assert sorted(there) == [*both]
        assert images.setdefault(used, shown.results[0].jpeg) == shown.results[0].jpeg
    assert len({b'', *images.values()}) == 3


def test_the_process_says_why_a_recording_cannot_be_shown_and_goes_on(tmp_path):
    broken = tmp_path / 'broken.mcap'
    broken.write_bytes(b'no bag')

    async def use():
        process = ReelProcess()
        try:
            with pytest.raises(ReelFailedError, match='broken'):
                await process.show(replace(FIRST, source=str(broken)))
            for child in set(active_children()) - before:
                child.kill()
                child.join()
            with pytest.raises(ReelFailedError):
                await process.show(FIRST)
            return await process.show(replace(FIRST, index=3))
        finally:
            process.end()

    async def use_and_close():
        process = ReelProcess()
        under_way = asyncio.create_task(process.show(FIRST))
        await asyncio.sleep(0)
        process.end()
        return await under_way

    before = set(active_children())
    assert asyncio.run(use_and_close()).count == 180
    ends = time.monotonic() + 60.0
    while set(active_children()) > before and time.monotonic() < ends:
        time.sleep(0.01)
    assert set(active_children()) == before
    assert asyncio.run(use()).results[0].said['trust'][1].startswith('5 of 5 lights')
