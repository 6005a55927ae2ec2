"""Compiled image kernels against plain NumPy: corners and their spread, depths, slopes, patches found again."""

import math

import numpy as np
import pytest

from stridetwin.estimators.dvio import patches
from stridetwin.estimators.dvio.tracker import FINE
from tests.estimators.from_python import from_python


def texture(height=90, width=120, shift=(0.0, 0.0), warp=None):
    """uint8 image of smooth waves, moved by `shift` px (x, y) and warped about its middle."""
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    u, v = x - shift[0] - width / 2, y - shift[1] - height / 2
    if warp is not None:
        inverse = np.linalg.inv(warp)
        u, v = inverse[0, 0] * u + inverse[0, 1] * v, inverse[1, 0] * u + inverse[1, 1] * v
    waves = np.sin(0.31 * u + 0.13 * v) + np.cos(0.17 * u - 0.29 * v) + np.sin(0.09 * u * 0.5 + 0.2 * v + 1.0)
    return np.round(127 + 38 * waves).astype(np.uint8)


def test_cornerness_is_the_eigenvalues_of_the_mean_gradient_tensor():
    grey = np.random.default_rng(0).integers(0, 256, (40, 50)).astype(np.uint8)
    g = grey.astype(float)
    dx, dy = np.zeros_like(g), np.zeros_like(g)
    dx[:, 1:-1], dy[1:-1] = (g[:, 2:] - g[:, :-2]) / 2, (g[2:] - g[:-2]) / 2
    for x, y, reach in ((20, 15, 3), (6, 30, 2), (44, 8, 1)):
        window = np.s_[y - reach : y + reach + 1, x - reach : x + reach + 1]
        d = np.stack([dx[window].ravel(), dy[window].ravel()])
        expected = np.linalg.eigvalsh(d @ d.T / d.shape[1])
        assert from_python(patches.cornerness)(grey, x, y, reach) == pytest.approx(expected, rel=1e-9)


def scored(grey, places, min_cornerness, min_roundness):
    """(N,) scores of candidates."""
    score = np.full(len(places), 7.0)
    from_python(patches.cornerness_at)(grey, places, min_cornerness, min_roundness, score)
    return score


def test_candidates_score_inside_the_margin_alone():
    grey = texture()
    places = np.array([[10, 10], [9, 40], [109, 79], [110, 40], [60, 80], [60, 9], [60.9, 40.9]], np.float32)
    score = scored(grey, places, 6.0, 0.0)
    assert (score >= 0).tolist() == [True, False, True, False, False, False, True]
    least, most = from_python(patches.cornerness)(grey, 60, 40, patches.CORNER_REACH_PX)
    assert score[6] == pytest.approx(least)
    assert (scored(grey, places, float(score.max()) + 1e-6, 0.0) == -1.0).all()
    for ratio, used in ((0.99, True), (1.01, False)):
        assert (scored(grey, places, 6.0, ratio * least / most)[6] >= 0.0) == used


def picked(candidates, taken, wanted, grid, min_distance_px, shape=(80, 100)):
    out = np.zeros((wanted, 2), np.float32)
    candidates, taken = (np.array(a, np.float32).reshape(-1, 2) for a in (candidates, taken))
    filled = np.zeros(grid, np.int64)
    count = from_python(patches.pick)(
        shape, candidates, np.arange(len(candidates)), taken, min_distance_px, filled, out
    )
    return out[:count].tolist()


def test_new_points_fill_empty_cells_first_and_keep_their_distance():
    cells = (8, 10), 4.0
    candidates = [[1, 1], [8, 8], [15, 5], [99, 79], [17, 5], [55, 41]]
    # cells are 10 px wide and high: (8, 8) waits for those in empty cells, (17, 5) is too close to (15, 5)
    assert picked(candidates, [], 9, *cells) == [[1, 1], [15, 5], [99, 79], [55, 41], [8, 8]]
    assert picked(candidates, [], 2, *cells) == [[1, 1], [15, 5]]
    # a cell with a point counts as filled, also one whose point lies beyond the image's border
    assert picked(candidates, [[3, 6], [120, 90]], 9, *cells) == [[15, 5], [55, 41], [1, 1], [99, 79], [8, 8]]
    assert picked(candidates, [[-5, -5], [50, 45]], 9, *cells) == [[15, 5], [99, 79], [1, 1], [55, 41], [8, 8]]
    near = picked([[12, 5], [20, 5], [12, 9.125]], [[16, 5]], 9, *cells)
    assert near == [[20, 5], [12, 5], [12, 9.125]]
    assert picked([[19.9, 5], [16, 9.1]], [[16, 5]], 9, *cells) == [[16, pytest.approx(9.1, abs=1e-5)]]


def test_a_cell_takes_four_points_at_most():
    cells = (1, 1), 1.0
    assert len(picked([[10 * k, 10] for k in range(9)], [], 9, *cells)) == 4
    assert len(picked([[10 * k, 10] for k in range(9)], [[5, 70], [50, 70]], 9, *cells)) == 2


def test_a_depth_is_the_median_about_a_point_and_none_next_to_an_edge():
    rng = np.random.default_rng(0)
    depth = (2.0 + rng.uniform(-0.02, 0.02, (40, 60))).astype(np.float32)
    depth[:, 40:] = 3.0
    depth[10, 10], depth[11, 11] = 0.0, 0.0
    depth[20, 20:23] = 0.0
    depth[30, 30], depth[30, 31] = 0.29, 6.51
    points = [[5.2, 4.9], [10, 10], [21, 20], [30, 30], [38.4, 20], [37.4, 20], [42, 20], [1.4, 20], [57.6, 20],
              [57.4, 20], [20, 37.6], [20, 1.4], [math.nan, 3], [3, 1e7]]  # fmt: skip
    rho = np.full(len(points), 9.0)
    from_python(patches.read_depth)(depth, np.array(points, np.float32), 0.3, 6.5, rho)

    def median(x, y):
        window = 1.0 / depth[y - 2 : y + 3, x - 2 : x + 3].ravel().astype(float)
        known = np.sort(window[(window >= 1 / 6.5) & (window <= 1 / 0.3)])
        return known[len(known) // 2]

    with np.errstate(divide="ignore"):
        expected = [
            median(5, 5),
            median(10, 10),
            0.0,
            median(30, 30),
            0.0,
            median(37, 20),
            median(42, 20),
            0.0,
            0.0,
            median(57, 20),
            0.0,
            0.0,
            0.0,
            0.0,
        ]
    np.testing.assert_allclose(rho, expected, rtol=1e-6)


def test_the_slope_of_a_plane_is_the_gradient_of_its_inverse_depth():
    x, y = np.meshgrid(np.arange(60.0), np.arange(50.0))
    rng = np.random.default_rng(1)
    inverse = 0.5 + 0.002 * x - 0.003 * y + rng.normal(0, 1e-4, x.shape)
    depth = (1.0 / inverse).astype(np.float32)
    depth[40, 52] = 0.0
    points = np.array([[20, 20], [30.4, 25.6], [50, 40], [7, 20], [20, 42], [8, 8]], np.float32)
    slope = patches.read_slope(depth, points, 0.3, 6.5, 1e-3)
    for n, (j, i) in {0: (20, 20), 1: (30, 26), 5: (8, 8)}.items():
        k = np.arange(-8, 9, 2)
        u, v = np.meshgrid(k, k)
        A = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
        values = 1.0 / depth[i + v, j + u].astype(float)
        fitted = np.linalg.lstsq(A, values.ravel(), rcond=None)
        np.testing.assert_allclose(slope[n], fitted[0][:2], rtol=1e-6)
        left = math.sqrt(fitted[1][0] / u.size)
        for roughness, known in ((1.01 * left, True), (0.99 * left, False)):
            assert patches.read_slope(depth, points[n : n + 1], 0.3, 6.5, roughness).any() == known
    assert not slope[2:5].any()


def test_a_patch_is_stored_with_its_gradients_and_their_products():
    grey, store = texture(), patches.blank_patches(3)
    points = np.array([[50.3, 40.6], [3.0, 2.0]], np.float32)
    from_python(patches.cut_patches)(grey, np.array([2, 0]), points, store)
    padded = np.pad(grey.astype(float), 20, mode="edge")

    def value(x, y):
        """Bilinear, the border replicated."""
        x, y = np.clip(x, 0, grey.shape[1] - 1) + 20, np.clip(y, 0, grey.shape[0] - 1) + 20
        j, i = int(x), int(y)
        a, b = x - j, y - i
        return (1 - b) * ((1 - a) * padded[i, j] + a * padded[i, j + 1]) + b * (
            (1 - a) * padded[i + 1, j] + a * padded[i + 1, j + 1]
        )

    for slot, (px, py) in ((2, points[0]), (0, points[1])):
        T = np.array([[value(px + j, py + i) for j in range(-7, 8)] for i in range(-7, 8)])
        B = np.stack([(T[1:-1, 2:] - T[1:-1, :-2]) / 2, (T[2:, 1:-1] - T[:-2, 1:-1]) / 2, T[1:-1, 1:-1]], -1).reshape(
            -1, 3
        )
        B -= B.mean(axis=0)
        np.testing.assert_allclose(store.basis[slot], B, atol=2e-2)
        np.testing.assert_allclose(store.inverse[slot], np.linalg.inv(B.T @ B), rtol=2e-2, atol=1e-7)
        assert store.power[slot] == pytest.approx((B[:, 2] ** 2).sum(), rel=1e-3)
    assert not store.power[1]
    from_python(patches.cut_patches)(np.full((90, 120), 99, np.uint8), np.array([2]), points[:1], store)
    assert not store.inverse[2].any()
    np.testing.assert_allclose(store.basis[2], 0.0, atol=1e-9)


def test_the_determinant_is_numpys():
    M = np.random.default_rng(3).normal(size=(3, 3))
    assert from_python(patches._determinant)(M) == pytest.approx(np.linalg.det(M), rel=1e-12)


def aligned(image, at, warp=None, limits=FINE):
    """Where the patch about the middle of the texture is found in an image from a first guess; None if it is not."""
    store, point = patches.blank_patches(2), np.array([[60.0, 45.0]], np.float32)
    from_python(patches.cut_patches)(texture(), np.array([1]), point, store)
    found, good = np.array([at], np.float32), np.array([True])
    warps = np.eye(2)[None] if warp is None else np.array(warp, float)[None]
    from_python(patches.align)(image, store, np.array([1]), warps, limits, found, good)
    return found[0] if good[0] else None


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.7, -0.4), (-1.3, 1.1)])
@pytest.mark.parametrize("warp", [None, ((1.1, 0.15), (-0.2, 0.9)), ((0.8, -0.3), (0.25, 1.2))])
def test_a_patch_is_found_where_it_has_moved(shift, warp):
    """Also stretched, rotated and brighter."""
    image = texture(shift=shift, warp=None if warp is None else np.array(warp))
    for gain, offset in ((1.0, 0.0), (0.6, 20.0)):
        changed = np.round(gain * image + offset).astype(np.uint8)
        found = aligned(changed, (60.0, 45.0), warp)
        np.testing.assert_allclose(found, [60.0 + shift[0], 45.0 + shift[1]], atol=0.06)


def test_a_patch_is_lost_beyond_its_reach_at_the_border_and_in_another_image():
    assert aligned(texture(shift=(1.5, 1.5)), (60.0, 45.0)) is None
    assert aligned(texture(shift=(1.5, 1.5)), (60.0, 45.0), limits=FINE._replace(max_move_px=2.5)) is not None
    noise = np.random.default_rng(0).integers(0, 256, (90, 120)).astype(np.uint8)
    assert aligned(noise, (60.0, 45.0)) is None
    assert aligned(255 - texture(), (60.0, 45.0)) is None
    assert aligned((0.15 * texture()).astype(np.uint8), (60.0, 45.0)) is None  # less than the least contrast
    assert aligned(texture(), (60.0, 45.0), ((3.2, 0.0), (0.0, 3.2))) is None  # a stretch of more than ten
    for place in ((8.0, 45.0), (112.0, 45.0), (60.0, 8.0), (60.0, 82.0)):
        image = texture(shift=(place[0] - 60.0, place[1] - 45.0))
        assert aligned(image, place) is None
        inside = np.array(place) + 0.1 * (np.array([60.0, 45.0]) - place) / np.linalg.norm(
            np.array([60.0, 45.0]) - place
        )
        shifted = texture(shift=(inside[0] - 60.0, inside[1] - 45.0))
        np.testing.assert_allclose(aligned(shifted, inside), inside, atol=0.06)
