import numpy as np
import pytest

from mvuav_ros.vision.point_operations import gamma_correct, intensity, threshold


def test_gamma_is_eq_3_2():
    levels = np.arange(256, dtype=np.uint8)[None]
    np.testing.assert_array_equal(
        gamma_correct(levels, 2.2), np.round((levels / 255) ** 2.2 * 255).astype(np.uint8)
    )
    assert gamma_correct(levels, 1.0) is levels


def test_gamma_of_16_bits():
    image = np.array([[0, 32768, 65535]], np.uint16)
    np.testing.assert_array_equal(gamma_correct(image, 0.5), [[0, 46341, 65535]])


@pytest.mark.parametrize('gamma', [0.0, -1.0, float('nan'), float('inf')])
def test_gamma_must_be_positive(gamma):
    with pytest.raises(ValueError, match='above 0'):
        gamma_correct(np.zeros((1, 1), np.uint8), gamma)


def test_intensity_is_eq_3_3():
    rng = np.random.default_rng(0)
    bgr = rng.integers(0, 256, (50, 50, 3), dtype=np.uint8)
    expected = bgr @ np.array([0.114, 0.587, 0.299])
    assert np.abs(intensity(bgr) - expected).max() <= 0.51


def test_threshold_of_the_thesis_begins_at_179():
    levels = np.arange(256, dtype=np.uint8)[None]
    assert np.flatnonzero(threshold(levels, 0.7))[0] == 179


def test_a_pixel_at_a_whole_limit_is_not_bright():
    levels = np.arange(256, dtype=np.uint8)[None]
    assert np.flatnonzero(threshold(levels, 0.2))[0] == 52


@pytest.mark.parametrize('dtype', [np.uint8, np.uint16])
def test_ends_of_the_range(dtype):
    scale = np.iinfo(dtype).max
    levels = np.array([[0, 1, scale - 1, scale]], dtype)
    np.testing.assert_array_equal(threshold(levels, 0.0), [[0, 255, 255, 255]])
    np.testing.assert_array_equal(threshold(levels, 1.0), [[0] * 4])


def test_16_bits_use_their_full_scale():
    levels = np.array([[45874, 45875]], np.uint16)
    np.testing.assert_array_equal(threshold(levels, 0.7), [[0, 255]])
