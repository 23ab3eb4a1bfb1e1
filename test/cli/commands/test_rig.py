"""`mvuav rig check`."""

from support.commands import mvuav
from support.places import ROOT


def test_the_shipped_rig_passes():
    run = mvuav('rig', 'check', ROOT / 'config' / 'tanker_747.yaml', '--distance', '60')
    assert (run.status, run.err) == (0, '')
    assert run.out.startswith('tanker_747: 5 markers, 59.6 m across\n')
    assert 'px rms  right_stabilizer -> right_wing' in run.out


def test_a_doubtful_rig_is_named_as_such(tmp_path):
    path = tmp_path / 'square.yaml'
    path.write_text('markers: {a: [0, 1, 1], b: [0, -1, 1], c: [0, -1, -1], d: [0, 1, -1]}')
    run = mvuav('rig', 'check', path)
    assert run.status == 1
    assert 'refused: the shape is symmetric: a -> b -> c -> d' in run.out


def test_a_line_has_no_table(tmp_path):
    path = tmp_path / 'line.yaml'
    path.write_text('markers: {a: [0, 1, 0], b: [0, 2, 0], c: [0, 4, 0]}')
    run = mvuav('rig', 'check', path)
    assert run.status == 1
    assert run.out.splitlines()[-1] == 'refused: all markers lie on one line: there is no pose'


def test_a_file_that_is_no_rig(tmp_path):
    run = mvuav('rig', 'check', tmp_path / 'none.yaml')
    assert run.status == 1
    assert 'No such file' in run.error
