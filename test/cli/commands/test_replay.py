"""One recording in, one bag out: what the options of `mvuav replay` do."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from rosbags import rosbag2
from support.calibrations import calibration_sample
from support.coded_videos import HEIGHT, WIDTH
from support.coded_videos import image as coded_image
from support.commands import (
    MARKERS,
    NO_LIGHT,
    NO_POSE,
    counts,
    mvuav,
    mvuav_process,
    read,
    stamp,
    stamps,
    write_flight,
)
from support.recording_samples import (
    IMAGE,
    STORE,
    TOPIC,
    Sample,
    cdr,
    image,
    image_samples,
    string_sample,
    write_mcap,
    write_ros1,
    write_rosbag2,
)

from mvuav_ros.messages.definitions import decode_message
from mvuav_ros.messages.images import Frame
from mvuav_ros.messages.sensors import IMU
from mvuav_ros.processing.processor import Processor
from mvuav_ros.processing.registry import PROCESSORS
from mvuav_ros.recordings.reading import open_recording
from mvuav_ros.recordings.writing import RecordingWriter
from mvuav_ros.sources.source import BEGINNING_NS

NODE = ('--nodes', 'marker_tracker')
SAMPLES = image_samples(30)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write_mcap(tmp_path / 'flight.mcap', SAMPLES)


def test_gamma_is_applied_before_the_nodes_see_an_image(bag: Path, tmp_path: Path) -> None:
    """The results are those of a recording whose images were corrected before."""
    corrected = []
    for number, sample in enumerate(SAMPLES):
        message = image(number, 64, 48)
        message.data = np.round((message.data / 255.0) ** 2 * 255).astype(np.uint8)
        corrected.append(sample._replace(data=cdr(message)))
    darker = write_mcap(tmp_path / 'darker.mcap', corrected)
    outs = tmp_path / 'a.mcap', tmp_path / 'b.mcap', tmp_path / 'c.mcap'
    detect = (*NODE, '--param', 'marker_tracker:mode:=detect_any')
    for source, out, more in (
        (bag, outs[0], ('--gamma', 2.0)),
        (darker, outs[1], ()),
        (bag, outs[2], ()),
    ):
        assert mvuav('replay', source, '-o', out, *detect, *more).status == 0
    results = [[message.data for message in read(out)] for out in outs]
    assert results[0] == results[1] != results[2]


def test_every_frame_has_an_answer_with_its_stamp(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / 'out.mcap'
    run = mvuav('replay', bag, '-o', out)
    # What the other node lacks differs from frame to frame.
    throughout = 'note: runway_detector, every frame: rows 50 to 130 are outside the 48 rows\n'
    assert (run.status, run.err) == (0, NO_POSE + throughout)
    assert run.out == f'{out}: results for 30 of 30 frames\n'
    assert stamps(out) == [sample.stamp_ns for sample in SAMPLES]
    assert stamps(out, '/runway_detector/line_params') == stamps(out)
    assert counts(out)['/runway_detector/statistics'] == 1
    message = decode_message('sensor_msgs/msg/PointCloud2', read(out)[0].data)
    assert message.header.frame_id == 'camera 0'


def test_an_output_that_exists_stays(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / 'out.mcap'
    out.write_bytes(b'mine')
    run = mvuav('replay', bag, '-o', out, *NODE)
    assert run.status == 1
    assert run.error == f'mvuav: {out} exists; --force overwrites it'
    assert out.read_bytes() == b'mine'
    assert mvuav('replay', bag, '-o', out, *NODE, '--force').status == 0
    assert len(stamps(out)) == 30
    # Also where the same run has made it: only into a folder is work resumed.
    assert 'exists' in mvuav('replay', bag, '-o', out, *NODE).error


@pytest.mark.parametrize('force', [(), ('--force',)])
def test_the_input_is_never_overwritten(tmp_path: Path, force: tuple[str, ...]) -> None:
    bag = write_mcap(tmp_path / 'flight.mcap', SAMPLES)
    content = bag.read_bytes()
    link = tmp_path / 'link.mcap'
    link.hardlink_to(bag)
    folder = write_rosbag2(tmp_path / 'folder', SAMPLES)
    files = set(folder.iterdir())
    inside = (folder / 'folder.mcap', folder)
    for source, out in ((bag, bag), (bag, link), *((folder, out) for out in inside)):
        assert 'is (in) the input itself' in mvuav('replay', source, '-o', out, *force).error
    assert set(folder.iterdir()) == files
    # Neither by the name of one of its files.
    form = ('--format', 'rosbag2')
    (part,) = folder.glob('*.mcap')
    for source, out, more in ((part, folder, form), (folder / 'metadata.yaml', part, ())):
        before = part.read_bytes()
        assert 'is (in) the input itself' in mvuav('replay', source, '-o', out, *more, *force).error
        assert 'the input itself' in mvuav('repair', source, '-o', out, *more, '--force').error
        assert part.read_bytes() == before
    run = mvuav('replay', bag, folder, '-o', tmp_path, *force)
    assert f'{bag} is (in) the input itself' in run.err
    assert bag.read_bytes() == content


@pytest.mark.parametrize('kind', ['mcap', 'sqlite3', 'ros1', 'file', 'message'])
def test_keep_inputs_copies_everything(tmp_path: Path, kind: str) -> None:
    samples = [*SAMPLES, *(string_sample(n) for n in range(30, 40))]
    if kind == 'ros1':
        bag = write_ros1(tmp_path / 'in.bag', samples)
    elif kind in ('mcap', 'sqlite3'):
        bag = write_rosbag2(tmp_path / 'in', samples, kind)
    else:
        bag = write_rosbag2(tmp_path / 'in', samples, 'mcap', kind)
    out = tmp_path / 'out.mcap'
    assert mvuav('replay', bag, '-o', out, *NODE, '--keep-inputs').status == 0
    with open_recording(bag) as recording:
        expected, topics = list(recording.messages()), recording.topics
    kept = [message for message in read(out) if not message.topic.startswith('/marker_tracker')]
    assert [message[:4] for message in kept] == [message[:4] for message in expected]
    with open_recording(out) as recording:
        written = {topic.name: topic for topic in recording.topics}
    for topic in topics:
        assert written[topic.name].qos == topic.qos
        assert topic.schema is None or written[topic.name].schema == topic.schema
    assert stamps(out) == [sample.stamp_ns for sample in SAMPLES]
    # An image stands right before its results.
    order = [message.topic for message in read(out)]
    assert order[order.index(MARKERS) - 1] == TOPIC


def test_keep_inputs_does_not_mix_old_results_with_new_ones(bag: Path, tmp_path: Path) -> None:
    first, second = tmp_path / 'first.mcap', tmp_path / 'second.mcap'
    assert mvuav('replay', bag, '-o', first, *NODE, '--keep-inputs').status == 0
    run = mvuav('replay', first, '-o', second, *NODE, '--keep-inputs')
    assert run.status == 0
    assert f'note: {MARKERS} of the input is not copied' in run.err
    assert counts(second) == counts(first)


def test_keep_inputs_leaves_results_beside_images_whose_stamps_count_from_another_time(
    tmp_path: Path,
) -> None:
    """A camera may stamp its images by the time since it was switched on."""
    messages = [image(n) for n in range(3)]
    for message in messages:
        message.header.stamp.sec = 5
    samples = [Sample(TOPIC, IMAGE, stamp(n), cdr(message)) for n, message in enumerate(messages)]
    bag, out = write_mcap(tmp_path / 'in.mcap', samples), tmp_path / 'out.mcap'
    assert mvuav('replay', bag, '-o', out, *NODE, '--keep-inputs').status == 0
    assert stamps(out) == stamps(out, TOPIC) == [stamp(n) for n in range(3)]
    clouds = [decode_message(m.type, m.data) for m in read(out) if m.topic == MARKERS]
    assert [cloud.header.stamp.sec for cloud in clouds] == [5, 5, 5]


@pytest.mark.parametrize('kind', ['video', 'folder'])
def test_keep_inputs_of_images_are_images(tmp_path: Path, kind: str) -> None:
    rows = np.linspace(0, 255, 48, dtype=np.uint8)[:, None, None]
    frames = [np.full((48, 64, 3), 8 * n, np.uint8) // 2 + rows // 2 for n in range(10)]
    source = tmp_path / 'flight'
    if kind == 'video':
        source = tmp_path / 'flight.avi'
        writer = cv2.VideoWriter(str(source), cv2.VideoWriter.fourcc(*'MJPG'), 20.0, (64, 48))
        for frame in frames:
            writer.write(frame)
        writer.release()
    else:
        source.mkdir()
        for number, frame in enumerate(frames):
            cv2.imwrite(str(source / f'{number}.png'), frame)
    out = tmp_path / 'out.mcap'
    run = mvuav('replay', source, '-o', out, *NODE, '--keep-inputs', '--fps', 20)
    # The brightest pixel is another in each image.
    assert (run.status, run.err) == (0, NO_LIGHT.replace('the brightest is 0; ', ''))
    expected = [n * 50_000_000 or BEGINNING_NS for n in range(10)]
    assert stamps(out) == stamps(out, '/image_raw') == expected
    kept = [m for m in read(out) if m.topic == '/image_raw']
    for message, frame in zip(kept, frames, strict=True):
        decoded = decode_message(message.type, message.data)
        assert (decoded.width, decoded.height, decoded.encoding) == (64, 48, 'bgr8')
        difference = decoded.data.reshape(48, 64, 3).astype(int) - frame
        assert np.abs(difference).max() <= (0 if kind == 'folder' else 12)
    # Velocities depend on the rate: one that nobody gave is named.
    run = mvuav('replay', source, '-o', out, *NODE, '--force')
    assert ('note: no stamps: 30 images/s are assumed' in run.err) is (kind == 'folder')


@pytest.mark.parametrize(
    ('options', 'expected'),
    [
        (('--start', 0.5), range(15, 30)),
        (('--duration', 0.5), range(15)),
        (('--start', 0.2, '--duration', 0.3), range(6, 15)),
        (('--every', 7), range(0, 30, 7)),
        (('--start', 0.2, '--duration', 0.5, '--every', 4), range(6, 21, 4)),
    ],
)
@pytest.mark.parametrize('kind', ['mcap', 'no index', 'sqlite3', 'ros1', 'folder', 'flight'])
def test_a_part_of_the_recording(
    tmp_path: Path, options: tuple[object, ...], expected: range, kind: str
) -> None:
    source: object
    samples = [s._replace(stamp_ns=s.stamp_ns + 1000) for s in SAMPLES]
    # The recording's beginning counts, not that of the images.
    samples.insert(0, string_sample(0))
    if kind == 'sqlite3':
        source = write_rosbag2(tmp_path / 'in', samples, 'sqlite3')
    elif kind == 'ros1':
        source = write_ros1(tmp_path / 'in.bag', samples)
    elif kind == 'folder':
        source = images = tmp_path / 'in'
        images.mkdir()
        for number in range(30):
            cv2.imwrite(str(images / f'{number}.png'), np.zeros((8, 8), np.uint8))
    elif kind == 'flight':
        source = 'sim:tanker?frames=30&fps=30&width=64&height=64'
    else:
        source = write_mcap(tmp_path / 'in.mcap', samples, summary=kind == 'mcap')
    out = tmp_path / 'out.mcap'
    run = mvuav('replay', source, '-o', out, *NODE, *options)
    assert run.status == 0
    assert f'results for {len(expected)} of {len(expected)} frames' in run.out
    first = 0 if kind == 'folder' else stamp(0)
    assert [round((s - first) * 30 / 1e9) for s in stamps(out)] == list(expected)
    run = mvuav('replay', source, '-o', out, *NODE, '--force', '--start', 1)
    assert 'is 0.97 s long: the start at 1 s lies beyond its end' in run.error


def test_a_part_keeps_all_inputs_of_that_time(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / 'out.mcap'
    options = ('--start', 0.2, '--duration', 0.5, '--every', 4, '--keep-inputs')
    assert mvuav('replay', bag, '-o', out, *NODE, *options).status == 0
    assert stamps(out, TOPIC) == [stamp(n) for n in range(7, 22)]
    assert stamps(out) == [stamp(n) for n in range(7, 22, 4)]


@pytest.mark.parametrize('kind', ['a.mp4', 'a.mkv', 'a.avi', 'images'])
def test_a_part_is_that_of_the_whole_and_what_is_before_it_need_not_be_sound(
    tmp_path: Path, kind: str
) -> None:
    source, lost, count = tmp_path / kind, 20, 150
    if kind == 'images':
        source.mkdir()
        for number in range(count):
            pixels = np.full((48, 64), number, np.uint8)
            copies = 1 + (number == lost)
            cv2.imwritemulti(str(source / f'{number}.tiff'), [pixels] * copies)
    else:
        with av.open(str(source), 'w') as container:
            stream = container.add_stream('libx264', rate=30, options={'bf': '0'})
            stream.width, stream.height, stream.codec_context.gop_size = WIDTH, HEIGHT, 10
            images = (coded_image(number % 20) for number in range(count))
            frames = [av.VideoFrame.from_ndarray(image, 'bgr24') for image in images]
            packets = [packet for frame in [*frames, None] for packet in stream.encode(frame)]
            del packets[lost + 3]
            container.mux(packets)
    whole, part = tmp_path / 'whole.mcap', tmp_path / 'part.mcap'
    options = (*NODE, '--keep-inputs')
    assert 'damage: ' in mvuav('replay', source, '-o', whole, *options).err
    run = mvuav('replay', source, '-o', part, *options, '--start', '3.01', '--duration', '1.5')
    assert run.status == 0
    assert ('damage: ' in run.err) == (kind == 'a.avi')  # which is read from its beginning
    inside = [each for each in read(whole) if 3_010_000_000 <= each.stamp_ns < 4_510_000_000]
    wanted = [(each.stamp_ns, each.data) for each in inside if each.topic == '/image_raw']
    found = [(each.stamp_ns, each.data) for each in read(part) if each.topic == '/image_raw']
    assert len(found) == 45 and found == wanted
    run = mvuav('replay', source, '-o', part, *options, '--force', '--start', 60)
    assert 'is 4.97 s long: the start at 60 s lies beyond its end' in run.error


@pytest.mark.parametrize('form', ['mcap', 'rosbag2'])
def test_an_output_stays_where_nothing_is_there_to_replace_it(
    bag: Path, tmp_path: Path, form: str
) -> None:
    out = tmp_path / ('out.mcap' if form == 'mcap' else 'out')
    replay = ('replay', bag, '-o', out, *NODE, '--format', form)
    assert mvuav(*replay).status == 0
    before = read(out)
    mistakes = (('--start', 100), 'long: the start'), (('--every', 2, '--duration', 0), 'is there')
    for mistake, said in mistakes:
        run = mvuav(*replay, '--force', *mistake)
        assert said in run.error
        assert read(out) == before


def test_several_image_topics_are_listed(tmp_path: Path) -> None:
    other = [s._replace(topic='/belly/image_raw') for s in SAMPLES[:3]]
    bag = write_mcap(tmp_path / 'in.mcap', [*SAMPLES, *other])
    out = tmp_path / 'out.mcap'
    error = mvuav('replay', bag, '-o', out).error
    assert f'{TOPIC} (Image, 30 messages), /belly/image_raw (Image, 3 messages)' in error
    assert 'choose one of' in mvuav('replay', bag, '-o', out, '--image-topic', '/no').error
    assert not out.exists()
    assert mvuav('replay', bag, '-o', out, *NODE, '--image-topic', '/belly/image_raw').status == 0
    assert len(stamps(out)) == 3


def test_frames_that_cannot_be_used(tmp_path: Path) -> None:
    short = image(8)
    short.data = short.data[:30]
    samples = list(SAMPLES)
    samples[8] = samples[8]._replace(data=cdr(short))
    samples[9] = samples[9]._replace(data=samples[8].data[:40])
    samples.insert(20, samples[19])
    bag, out = write_mcap(tmp_path / 'in.mcap', samples), tmp_path / 'out.mcap'
    run = mvuav('replay', bag, '-o', out, *NODE)
    assert run.status == 0
    assert 'results for 28 of 31 frames' in run.out
    *warnings, note = run.err.splitlines(keepends=True)
    assert note == NO_POSE
    assert len(warnings) == 3 and all(line.startswith('warning: 1 without') for line in warnings)
    strict = mvuav('replay', bag, '-o', out, *NODE, '--force', '--strict')
    assert strict.status == 1
    assert 'strict' in strict.error
    assert len(stamps(out)) == 28


def test_strict_accepts_what_is_whole(tmp_path: Path) -> None:
    folder = write_rosbag2(tmp_path / 'bag', SAMPLES)
    (folder / 'metadata.yaml').unlink()
    run = mvuav('replay', folder, '-o', tmp_path / 'out.mcap', *NODE, '--strict')
    assert run.status == 0
    assert run.err == 'note: bag: metadata.yaml is missing\n' + NO_POSE


def test_strict_refuses_a_cut_recording(tmp_path: Path) -> None:
    bag = write_mcap(tmp_path / 'in.mcap', SAMPLES)
    bag.write_bytes(bag.read_bytes()[:-20_000])
    for option, status in (((), 0), (('--strict',), 1)):
        run = mvuav('replay', bag, '-o', tmp_path / 'o.mcap', *NODE, '--force', *option)
        assert run.status == status
        assert 'cut off' in run.err


def test_one_node_refusing_a_frame_does_not_silence_the_other(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(PROCESSORS['marker_tracker'], '_process', lambda *_: 1 / 0)
    out = tmp_path / 'out.mcap'
    run = mvuav('replay', bag, '-o', out)
    assert 'internal error of marker_tracker: ZeroDivisionError' in run.err
    assert 'not a single frame' in run.error
    with open_recording(out) as recording:
        topics = [message.topic for message in recording.messages()]
    assert topics.count('/runway_detector/lines') == 30


def test_parameters_come_from_file_and_command_line(tmp_path: Path) -> None:
    bright = image(0, 8, 8, noisy=False)
    bright.data[:] = 100
    samples = [Sample(TOPIC, IMAGE, stamp(0), cdr(bright))]
    bag = write_mcap(tmp_path / 'in.mcap', samples)
    file = tmp_path / 'p.yaml'
    file.write_text(
        '/**/marker_tracker:\n  ros__parameters:\n    mode: detect_any\n    threshold: 0.3\n'
    )

    def rows(*options: object) -> int:
        out = tmp_path / 'out.mcap'
        assert mvuav('replay', bag, '-o', out, *NODE, '--force', *options).status == 0
        return decode_message('sensor_msgs/msg/PointCloud2', read(out)[0].data).width

    assert rows() == 5
    assert rows('--params-file', file) == 1
    assert rows('--params-file', file, '--param', 'marker_tracker:threshold:=0.9') == 0


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        (('--param', 'marker_tracker:threshold:=2'), 'threshold'),
        (('--param', 'marker_tracker:nonsense:=2'), 'no such parameter'),
        (('--param', 'nonsense'), 'node:name:=value'),
        (('--param', 'runway_detector:num_peaks:=2'), 'is not among'),
        (('--params-file', '/does/not/exist.yaml'), 'No such file'),
        (('--nodes', 'nonsense'), 'there are marker_tracker, runway_detector'),
        (('--every', '0'), 'every'),
        (('--jobs', '0'), 'jobs'),
        (('--start', '-1'), 'start'),
        (('--fps', '0'), 'fps'),
        (('--fps', 'inf'), 'fps'),
        (('--start', 'inf'), 'start'),
        (('--duration', 'inf'), 'duration'),
        (('--split-mb', '5'), 'add --format rosbag2'),
        (('--nonsense',), 'nonsense'),
    ],
)
def test_mistakes_cost_one_line(
    bag: Path, tmp_path: Path, options: tuple[str, ...], words: str
) -> None:
    out = tmp_path / 'out.mcap'
    run = mvuav('replay', bag, '-o', out, *NODE, *options)
    assert run.status in (1, 2)
    assert words in run.error
    assert len(run.err.splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ('name', 'out', 'words'),
    [
        ('flight.mcap', 'out.bag', 'must end in .mcap'),
        ('flight.mcap', 'text.txt/out.mcap', 'text.txt cannot be made'),
        ('nothing.mcap', 'out.mcap', 'no such file'),
        ('text.mcap', 'out.mcap', 'holds no readable topic'),
        ('empty.mcap', 'out.mcap', 'is empty'),
        ('text.txt', 'out.mcap', 'is not a video'),
        ('folder', 'out.mcap', 'no images and no bag'),
    ],
)
def test_what_cannot_be_read_or_written(
    bag: Path, tmp_path: Path, name: str, out: str, words: str
) -> None:
    (tmp_path / 'text.mcap').write_text('this is not a bag, whatever its name says')
    (tmp_path / 'text.txt').write_text('nor a video')
    (tmp_path / 'empty.mcap').touch()
    (tmp_path / 'folder').mkdir()
    run = mvuav('replay', tmp_path / name, '-o', tmp_path / out)
    assert run.status == 1
    assert words in run.error
    assert len(run.err.splitlines()) == 1


def test_the_folder_of_the_output_is_made(bag: Path, tmp_path: Path) -> None:
    out = tmp_path / 'new' / 'folder'
    assert mvuav('replay', bag, '-o', out / 'replayed.mcap', *NODE).status == 0
    assert mvuav('repair', bag, '-o', out / 'more' / 'repaired.mcap').status == 0
    flight = ('simulate', 'tanker', '-o', out / 'most' / 'flight.mcap', '--frames', 1)
    assert mvuav(*flight).status == 0
    assert len(list(out.rglob('*.mcap'))) == 3


def test_the_camera_comes_with_the_bag(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracker = PROCESSORS['marker_tracker']
    seen: list[float | None] = []
    process = tracker.process

    def noted(self: Processor, frame: Frame, *arguments: Any) -> object:
        seen.append(frame.camera.k[0] if frame.camera else None)
        return process(self, frame, *arguments)

    monkeypatch.setattr(tracker, 'process', noted)
    samples = [*SAMPLES[:2], calibration_sample(2, 500.0), SAMPLES[3], calibration_sample(4, 600.0)]
    samples += [SAMPLES[5], calibration_sample(6, 700.0)._replace(topic='/belly/camera_info')]
    bag = write_mcap(tmp_path / 'in.mcap', samples)
    assert mvuav('replay', bag, '-o', tmp_path / 'out.mcap', *NODE).status == 0
    assert seen == [None, None, 500.0, 600.0]
    seen.clear()
    # An image waits for the calibration of its own stamp, as in a live node.
    samples = [
        SAMPLES[0],
        calibration_sample(0, 500.0),
        SAMPLES[1],
        SAMPLES[2],
        calibration_sample(2, 600.0),
    ]
    bag = write_mcap(tmp_path / 'after.mcap', samples)
    assert mvuav('replay', bag, '-o', tmp_path / 'after_out.mcap', *NODE).status == 0
    assert seen == [500.0, 500.0, 600.0]
    seen.clear()
    # One that was published once holds for a part that begins later.
    part = ('--start', '0.05')
    samples = [calibration_sample(0, 500.0), *SAMPLES[:6]]
    bag = write_mcap(tmp_path / 'once.mcap', samples)
    assert mvuav('replay', bag, '-o', tmp_path / 'part.mcap', *NODE, *part).status == 0
    assert 0 < len(seen) < 6 and set(seen) == {500.0}
    seen.clear()
    # Of several the newest before the part.
    samples = [
        calibration_sample(0, 500.0),
        SAMPLES[0],
        calibration_sample(1, 600.0),
        *SAMPLES[1:6],
    ]
    bag = write_mcap(tmp_path / 'twice.mcap', samples)
    part = (*part, '--force')
    assert mvuav('replay', bag, '-o', tmp_path / 'part.mcap', *NODE, *part).status == 0
    assert 0 < len(seen) < 6 and set(seen) == {600.0}
    seen.clear()
    assert mvuav('replay', 'sim:tanker?frames=2', '-o', tmp_path / 'sim.mcap', *NODE).status == 0
    assert len(seen) == 2 and all(focal_length and focal_length > 0 for focal_length in seen)


def test_a_topic_may_have_messages_of_several_types(tmp_path: Path) -> None:
    header, unknown = image(0).header, np.zeros(9)
    place, turn = (STORE.types[f'geometry_msgs/msg/{kind}'] for kind in ('Vector3', 'Quaternion'))
    still, level = place(0, 0, 0), turn(0, 0, 0, 1)
    attitude = STORE.types[IMU](header, level, unknown, still, unknown, still, unknown)
    others = [string_sample(1)._replace(topic=name) for name in ('/camera/camera_info', '/imu')]
    samples = [calibration_sample(0, 500.0), Sample('/imu', IMU, stamp(0), cdr(attitude)), *others]
    bag = tmp_path / 'in.mcap'
    with RecordingWriter(bag) as writer:
        for sample in [*samples, *SAMPLES[1:3]]:
            writer.write(*sample)
    nodes = ('--nodes', 'runway_detector', '--param', 'runway_detector:mode:=approach')
    run = mvuav('replay', bag, '-o', tmp_path / 'out.mcap', *nodes)
    assert run.status == 0 and 'results for 2 of 2 frames' in run.out


def test_the_output_says_from_what_it_was_made(bag: Path, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    out = tmp_path / 'out.mcap'
    mvuav('replay', bag, '-o', out, *NODE, '--param', 'marker_tracker:threshold:=0.25')
    with out.open('rb') as stream:
        metadata = {m.name: m.metadata for m in make_reader(stream).iter_metadata()}
    assert metadata['mvuav_replay']['input'] == str(bag)
    settings = json.loads(metadata['mvuav_replay']['settings'])
    assert settings['parameters']['marker_tracker']['threshold'] == 0.25


def test_a_rosbag2_folder_with_metadata(bag: Path, tmp_path: Path) -> None:
    single, folder = tmp_path / 'single.mcap', tmp_path / 'flight'
    assert mvuav('replay', bag, '-o', single, '--keep-inputs').status == 0
    options = ('--keep-inputs', '--format', 'rosbag2')
    run = mvuav('replay', bag, '-o', folder, *options)
    assert run.out == f'{folder}: results for 30 of 30 frames\n'
    assert sorted(path.name for path in folder.iterdir()) == ['flight_0.mcap', 'metadata.yaml']
    assert read(folder) == read(single)
    with rosbag2.Reader(folder) as reader:
        assert reader.message_count == len(read(single))
        assert {connection.topic for connection in reader.connections} == set(counts(single))
    assert 'exists' in mvuav('replay', bag, '-o', folder, *options).error
    assert mvuav('replay', bag, '-o', folder, *options, '--force').status == 0


def test_rosbag2_folders_of_several_recordings_split_by_size(tmp_path: Path) -> None:
    bags = [write_mcap(tmp_path / f'{name}.mcap', image_samples(240, 128, 96)) for name in 'ab']
    options = ('--format', 'rosbag2', '--split-mb', '1', *NODE, '--keep-inputs')
    for words in ('results for 240', 'finished before, results for 240'):
        run = mvuav('replay', *bags, '-o', tmp_path / 'out', *options)
        assert run.out.count(words) == 2
        for name in 'ab':
            folder = tmp_path / 'out' / name
            assert len(list(folder.glob(f'{name}_*.mcap'))) > 2
            assert len(stamps(folder)) == 240
            with rosbag2.Reader(folder) as reader:
                assert reader.message_count == len(read(folder))


def test_json_has_the_recordings_whatever_became_of_them(tmp_path: Path) -> None:
    write_flight(tmp_path / 'flights' / 'good.mcap', 3)
    (tmp_path / 'flights' / 'bad.mcap').write_bytes(b'nothing')
    run = mvuav_process('replay', tmp_path / 'flights', '-o', tmp_path / 'out', *NODE, '--json')
    assert run.status == 1
    said = {Path(each['output']).stem: each for each in json.loads(run.out)['recordings']}
    assert said['good']['processed'] == 3 and said['bad']['failure']
    for each in said.values():
        assert list(each)[:4] == ['source', 'output', 'frames', 'processed']
    images = tmp_path / 'images'
    images.mkdir()
    for number in range(3):
        cv2.imwrite(str(images / f'{number}.png'), np.zeros((48, 64), np.uint8))
    (images / '1.png').write_bytes(b'torn')
    out = tmp_path / 'images.mcap'
    run = mvuav('replay', images, '-o', out, *NODE, '--json', '--strict')
    assert run.status == 1 and '--strict' in run.error
    (one,) = json.loads(run.out)['recordings']
    assert sum(one['rejected'].values()) == 1


def test_each_reason_says_of_which_of_several_recordings_it_is(tmp_path: Path) -> None:
    for name in ('first', 'second'):
        (tmp_path / 'in' / name).mkdir(parents=True)
        for number in range(2):
            place = tmp_path / 'in' / name / f'{number}.png'
            cv2.imwrite(str(place), np.zeros((48, 64), np.uint8))
        place.write_bytes(b'torn')
    run = mvuav_process('replay', tmp_path / 'in', '-o', tmp_path / 'out', *NODE)
    assert run.status == 0
    for kind in ('warning', 'note'):
        said = [line for line in run.err.splitlines() if line.startswith(f'{kind}: ')]
        assert {Path(line.split(': ')[1]).name for line in said} == {'first', 'second'}
    alone = mvuav('replay', tmp_path / 'in' / 'first', '-o', tmp_path / 'alone.mcap', *NODE)
    assert 'warning: 1 without a result: 1.png' in alone.err


def test_flights_that_are_simulated_have_names_of_their_own(tmp_path: Path) -> None:
    flights = ('sim:tanker?frames=2', 'sim:runway?frames=2&width=320&height=240')
    run = mvuav_process('replay', *flights, '-o', tmp_path / 'out', '--jobs', 1)
    assert run.status == 0
    names = {path.name for path in (tmp_path / 'out').glob('*.mcap')}
    assert names == {'tanker_frames=2.mcap', 'runway_frames=2_width=320_height=240.mcap'}


def test_an_empty_folder_may_become_a_rosbag2_folder(tmp_path: Path) -> None:
    bag, out = write_flight(tmp_path / 'in.mcap', 3), tmp_path / 'out'
    out.mkdir()
    assert mvuav('replay', bag, '-o', out, *NODE, '--format', 'rosbag2').status == 0
    assert (out / 'metadata.yaml').exists()
