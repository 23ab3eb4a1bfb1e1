"""The installer asks the index that pip is configured for."""

from support.places import ROOT, load_tool

installer = load_tool('install')


def test_pips_settings_become_uvs():
    options, variables = installer.uv_settings(
        {
            'index-url': 'https://mirror.example/simple',
            'extra-index-url': 'https://a.example/simple https://b.example/simple',
            'trusted-host': 'mirror.example',
            'no-index': 'false',
            'proxy': 'http://proxy.example:3128',
            'cert': '/etc/ssl/ours.pem',
            'timeout': '15',
        }
    )
    assert options == [
        *('--default-index', 'https://mirror.example/simple'),
        *('--index', 'https://a.example/simple', '--index', 'https://b.example/simple'),
        *('--allow-insecure-host', 'mirror.example'),
    ]
    assert variables == {
        'SSL_CERT_FILE': '/etc/ssl/ours.pem',
        'ALL_PROXY': 'http://proxy.example:3128',
    }


def test_a_variable_wins_over_a_file(tmp_path):
    told = tmp_path / 'pip'
    told.write_text(
        '#!/bin/sh\necho ":env:.index-url=\'https://env.example\'"\n'
        'echo "global.index-url=\'https://global.example\'"\n'
        'echo "install.find-links=\'/wheels\'"\n'
    )
    told.chmod(0o755)
    settings = installer.pip_settings([str(told)])
    assert settings == {'index-url': 'https://env.example', 'find-links': '/wheels'}


def test_the_first_index_counts_and_never_the_highest_version(tmp_path, capfd):
    told = tmp_path / 'uv'
    told.write_text(
        f'#!/bin/sh\necho "$@" >> {tmp_path}/asked\necho "not at version 1" >&2\n'
        'case "$*" in *unsafe*) ;; *) exit 1;; esac\n'
    )
    told.chmod(0o755)
    python = tmp_path / 'python'
    python.write_text('#!/bin/sh\n')
    python.chmod(0o755)
    assert installer.install(python, 'installing', ['numpy'])
    asked = (tmp_path / 'asked').read_text().splitlines()
    assert [line.split()[-1] for line in asked] == ['first-index', 'unsafe-first-match']
    # That one index lacks a version is no failure.
    assert capfd.readouterr().err == 'installing: 0 s\n'
    told.write_text('#!/bin/sh\necho "nowhere at version 1" >&2\nexit 1\n')
    assert installer.install(python, 'installing', ['numpy'])
    assert 'nowhere at version 1\nuv could not; trying pip' in capfd.readouterr().err


def test_what_is_installed_is_pinned():
    for name in ('tested.txt', 'robot.txt'):
        lines = (ROOT / 'requirements' / name).read_text().splitlines()
        wanted = [line for line in lines if line and not line.startswith('#')]
        assert wanted and all('==' in line for line in wanted)
    workflow = (ROOT / '.github' / 'workflows' / 'ci.yml').read_text()
    assert 'permissions:\n  contents: read\n' in workflow
    uses = [line.split('@')[1].split()[0] for line in workflow.splitlines() if 'uses:' in line]
    assert uses and all(len(commit) == 40 for commit in uses)
