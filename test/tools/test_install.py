"""The installer asks the index that pip is configured for."""

import importlib.util

import pytest
from support.places import ROOT


@pytest.fixture(scope='module')
def installer():
    spec = importlib.util.spec_from_file_location('install', ROOT / 'tools' / 'install.py')
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_pips_settings_become_uvs(installer):
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


def test_a_variable_wins_over_a_file(installer, tmp_path):
    told = tmp_path / 'pip'
    told.write_text(
        '#!/bin/sh\necho ":env:.index-url=\'https://env.example\'"\n'
        'echo "global.index-url=\'https://global.example\'"\n'
        'echo "install.find-links=\'/wheels\'"\n'
    )
    told.chmod(0o755)
    settings = installer.pip_settings([str(told)])
    assert settings == {'index-url': 'https://env.example', 'find-links': '/wheels'}
