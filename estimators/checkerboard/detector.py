"""Detection of the other shoe's checkerboard in a shoe camera's image: corners, their identities and uncertainty.

Corners are identified if the whole board is visible, or if no other part of it can be near the prediction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.estimators.checkerboard import saddle_points
from stridetwin.estimators.checkerboard.pattern import BoardPattern, DistortionModel, View, sample
from stridetwin.estimators.checkerboard.pose import BoardObservation
from stridetwin.estimators.checkerboard.search import find_anywhere, find_near, view_from_guess
from stridetwin.streams.errors import StrideTwinError
from stridetwin.streams.rig import Board, CameraCalibration
from stridetwin.streams.samples import Array, Image

# Hand-chosen; lengths are in squares unless stated otherwise.
_BLUR_SD = 0.12  # initial blur
_SHARP_PX = 0.4  # blur of an image at rest
_FLATNESS = 0.06  # largest distance of a corner from a plane board's, or 5 standard deviations if that is more
_MAX_MISFIT = 0.35  # RMS residual of a corner over half its step in brightness
_MIN_CONTRAST = 0.35  # half step in brightness of a corner over the median of all
_MIN_STEP = 6.0  # half step in brightness of the median corner, of 255
_MAX_CORNER_SD = 0.05  # corners with a larger standard deviation are rejected
_MIN_CORNERS = 8  # of an observation
_MIN_SMEAR = 0.4  # motion along both axes that is distinguished from other blur
_MAX_SHARP = 0.7  # a board with the blur of a longer motion counts as smeared
_MAX_SMEAR = 1.7  # a board with a longer motion is unreadable: its squares blend into their neighbours
# Largest such motion along both axes at once: along the diagonal squares have one colour, which hides the motion.
_MAX_STREAK = 0.65
_SMEARED_SHARE = 0.65  # of all corners that a smeared board must show
_SMEARED_MISFIT = 0.12  # largest misfit of its median corner
_CLEAR_CONTRAST = 0.15  # from the mean brightness, in half steps, of a clearly bright or dark cell
_MAX_HIDDEN_CELLS = 3  # of a whole board that dirt may hide: fewer dark ones than any shift would miss
_PASSES = 2  # largest number of refits of the view, because one from few corners is inaccurate at the others
_CORNER_SD_PX = 0.02  # error of a corner in addition to its residuals: remaining errors of lens and print
_SMEAR_SD = 0.01  # further error of a corner, as a share of the motion that blurs the board


def is_complete(grey: NDArray[np.uint8], pattern: BoardPattern, view: View, corners: Array, levels: Array) -> bool:
    """Whether nearly all squares and cells of the margin have their colours, so that no other placement is possible.

    Args:
        grey: (H, W) image.
        pattern: The board.
        view: View of the board.
        corners: (N, 2) places of the detected corners, squares.
        levels: (N, 2) middle and half step of the brightness at each; both change slowly over a board.

    Returns:
        True if at most `_MAX_HIDDEN_CELLS` cells lack their colour; cells outside the image lack it.
    """
    # both levels as planes over the board, fitted to the corners and evaluated at the cells' centres, (C,) each
    plane, *_ = np.linalg.lstsq(_plane_design(corners), levels, rcond=None)
    middle, step = (_plane_design(pattern.cells) @ plane).T
    # (C,) brightness of each cell: 1 for a bright one, -1 for a dark one, NaN outside the image; a half step of less
    # than one grey level counts as one
    contrast = (sample(grey, view.pixels(pattern.cells)) - middle) / np.maximum(step, 1.0)
    has_colour = contrast * pattern.bright.ravel() > _CLEAR_CONTRAST  # False outside the image
    return int((~has_colour).sum()) <= _MAX_HIDDEN_CELLS


def is_unambiguous(pattern: BoardPattern, view: View, indices: NDArray[np.intp], near: Array, reach_px: float) -> bool:
    """Whether no other corners of the board fit near the prediction.

    An occluder may be as white as the board's margin (a stair edge is), so the margin proves nothing: the squares
    around the detected corners may be any of the board's with these colours.

    Args:
        pattern: The board.
        view: View of the board.
        indices: (N,) indices of the detected corners in `BoardPattern.corners`.
        near: (2,) predicted centre of the board, pixels.
        reach_px: Largest error of the prediction, pixels.
    """
    columns, rows = pattern.shape
    # rows and columns of the detected corners, and all shifts (i, j) that keep them on the board
    v, u = np.divmod(indices, columns)
    j, i = np.mgrid[-v.min() : rows - v.max(), -u.min() : columns - u.max()]
    # the other shifts that keep the colours: the detected corners would be those i columns and j rows farther on
    placements = ((i + j) % 2 == 0) & ((i != 0) | (j != 0))
    if not placements.any():
        return True
    # where the board's centre would be, px
    centres = view.pixels(-np.column_stack([i[placements], j[placements]]).astype(float))
    return not (np.linalg.norm(centres - near, axis=1) <= reach_px).any()


def _plane_design(squares: Array) -> Array:
    """(N, 3) design matrix of a plane over (N, 2) points: 1, u, v."""
    return np.column_stack([np.ones(len(squares)), squares])


_BOX = 12.0  # variance of a Gaussian that blurs as much as a box: its width squared over this


@dataclass(frozen=True, kw_only=True, eq=False)
class Smear:
    """Blur of a board's image.

    Attributes:
        blur: (2,) standard deviation of a Gaussian across the edges u = 0 and v = 0, squares.
        motion: (2,) motion along u and v during the exposure, squares, in addition; None: not known.
    """

    blur: Array
    motion: Array | None

    def total_motion(self, sharp: Array) -> Array:
        """(2,) motion along u and v, squares, that would cause all the blur beyond that at rest.

        `sharp` (2,) is the blur at rest across both families of edges, squares. The known motion is included.
        """
        known_motion = np.zeros(2) if self.motion is None else self.motion
        # a motion smears like a box as wide as it; variances of independent blurs add
        return np.sqrt(_BOX * np.maximum(self.blur**2 - sharp**2, 0.0) + known_motion**2)


@dataclass(frozen=True, kw_only=True, eq=False)
class BoardFit:
    """Result of a fit to an image.

    Attributes:
        view: View of the board.
        indices: (N,) indices of the accepted corners.
        corners: (N, saddle_points.COLUMNS) fits of the accepted corners.
        sd_px: (N,) standard deviations of the accepted corners, pixels.
    """

    view: View
    indices: NDArray[np.intp]
    corners: Array
    sd_px: Array


class BoardDetector:
    """Detects one board in the images of one camera; stateless.

    Args:
        board: The board to detect; its mount does not matter.
        camera: The calibrated camera; its mount does not matter.

    Attributes:
        points_in_board: (M, 3) all interior corners in the board's frame, m, y slowest: the order of a guess.

    Raises:
        ConfigError: A board that looks the same from two sides, or an unknown distortion model.
    """

    def __init__(self, board: Board, camera: CameraCalibration) -> None:
        self._pattern, self._lens = BoardPattern(board), DistortionModel(camera)
        self._shift_ns = round(camera.timeshift_cam_imu_s * 1e9)  # added to an image's stamp: time on the IMUs' clock
        self.points_in_board = self._pattern.points_in_board

    def predict(self, T_camera_board: ArrayLike) -> Array | None:
        """(M, 2) pixels of all corners, also outside the image, of a board at a pose (4, 4) in the optical frame.

        None if it is behind the camera, seen from behind, or beyond the reach of the lens.
        """
        T = np.asarray(T_camera_board, dtype=float)
        if T[:3, 3] @ T[:3, 2] >= 0:  # the board's z axis points away from the camera
            return None
        p = self.points_in_board @ T[:3, :3].T + T[:3, 3]  # (M, 3) m, corners in the optical frame
        if p[:, 2].min() <= 0:  # not in front of the camera
            return None
        pixels = self._lens.pixels(p[:, :2] / p[:, 2:])
        return pixels if np.isfinite(pixels).all() else None

    def detect(
        self, image: Image, guess: Array | None = None, guess_error_px: float = 40.0, motion_px: Array | None = None
    ) -> BoardObservation | None:
        """Detects the corners of the board in one image.

        With a guess, only that region is searched, in a few milliseconds, and a partly visible or blurred board is
        detected as well. Without one, the whole image is searched for a whole board, in some ten milliseconds.

        Args:
            image: Grey image (H, W) of the camera.
            guess: (M, 2) predicted pixels of the corners, in the order of `points_in_board` (`predict`); NaN
                means that nothing is searched.
            guess_error_px: Largest error of the guess, pixels. It may exceed a square if the whole board is visible; a
                part of the board is accepted only if no other part could be so near to the guess.
            motion_px: (2,) motion of the board in the image during the exposure, pixels; None = from the blur.

        Returns:
            None if no board is visible, or if the corners cannot be identified with certainty.

        Raises:
            StrideTwinError: An image of another shape than the camera's, or a guess of another shape than the board's.
        """
        grey = self._read_grey(image)
        near = None if guess is None else np.mean(guess, axis=0)  # (2,) px, predicted centre of the board
        for rough in self._candidates(grey, guess, guess_error_px):
            fit = self._fit_board(grey, rough, motion_px)
            if fit is not None and self._is_identified(grey, fit, near, guess_error_px):
                return BoardObservation(
                    topic=image.topic,
                    t_ns=image.t_ns + self._shift_ns,
                    points_in_board=self.points_in_board[fit.indices],
                    rays=self._lens.rays(fit.corners[:, :2]),
                    ray_sd=fit.sd_px / self._lens.focal_px,
                )
        return None

    def _read_grey(self, image: Image) -> NDArray[np.uint8]:
        """(H, W) pixels of an image, contiguous.

        Raises:
            StrideTwinError: Its shape or type is not the camera's.
        """
        width, height = self._lens.size
        if image.pixels.shape != (height, width) or image.pixels.dtype != np.uint8:
            raise StrideTwinError(
                f"{image.topic}: image of shape {image.pixels.shape} and type {image.pixels.dtype}; "
                f"the calibration says ({height}, {width}), uint8"
            )
        return np.ascontiguousarray(image.pixels)

    def _candidates(self, grey: NDArray[np.uint8], guess: Array | None, error_px: float) -> Iterator[View]:
        """Views of the board to try, the most likely first: near the guess, or anywhere without one.

        Raises:
            StrideTwinError: The guess has another shape than the board.
        """
        if guess is None:
            yield from find_anywhere(grey, self._pattern, self._lens)
            return
        if np.shape(guess) != self._pattern.corners.shape:
            raise StrideTwinError(f"guess of shape {np.shape(guess)}; the board has {self._pattern.corners.shape}")
        if (view := view_from_guess(self._pattern, self._lens, np.asarray(guess, dtype=float))) is not None:
            yield from find_near(grey, self._pattern, view, error_px)

    def _fit_board(self, grey: NDArray[np.uint8], rough: View, motion_px: Array | None) -> BoardFit | None:
        """The refined view and its accepted corners; None if there are too few, or the motion hides the pattern.

        First the corners are fitted from the rough view, each with its own blur. Their positions give a better view,
        and the median of their blurs the smear. From these all corners are fitted anew. Last, the view is refined as
        long as that adds corners.

        Args:
            grey: (H, W) image.
            rough: Candidate view.
            motion_px: (2,) motion of the board in the image during the exposure, pixels; None: not known.
        """
        corners = self._pattern.corners
        motion = None if motion_px is None else rough.to_squares(motion_px)  # (2,) along u and v, squares
        if motion is not None and not _is_readable(np.abs(motion)):
            return None
        initial = Smear(blur=np.full(2, _BLUR_SD), motion=motion)
        first = self._fit_all_corners(grey, rough, initial, True)  # (M, COLUMNS)
        good = first[:, saddle_points.OK] > 0
        if good.sum() < _MIN_CORNERS:
            return None
        # largest error of a corner in the view, in units of a ray
        tolerance = _FLATNESS * np.median(rough.size_px(corners)) / self._lens.focal_px
        view = View.from_points(self._lens, corners[good], self._lens.rays(first[good, :2]), tolerance)
        if view is None:
            return None
        blur = np.median(first[good][:, (saddle_points.BLUR_U, saddle_points.BLUR_V)], axis=0)
        # (2,) blur at rest, squares
        sharp = _SHARP_PX / np.linalg.norm(view.edges(np.zeros((1, 2)))[0], axis=1)
        # of all possible smears, the one whose fits leave the least residuals
        trials = [
            (smear, self._fit_all_corners(grey, view, smear, False))
            for smear in self._possible_smears(blur, motion, sharp)
        ]
        smear, fits = min(trials, key=lambda trial: _median_misfit(trial[1]))
        motion_uv = smear.total_motion(sharp)
        fit = self._accept_corners(view, fits, motion_uv)
        for _ in range(_PASSES):
            if len(fit.indices) in (len(corners), 0):  # nothing to add, or nothing to refine from
                break
            closer = View.from_points(self._lens, corners[fit.indices], self._lens.rays(fit.corners[:, :2]))
            if closer is None:
                break
            again = self._accept_corners(closer, self._fit_all_corners(grey, closer, smear, False), motion_uv)
            if len(again.indices) <= len(fit.indices):
                break
            fit = again
        return fit if self._is_sufficient(fit, motion_uv) else None

    def _accept_corners(self, view: View, fits: Array, motion_uv: Array) -> BoardFit:
        """The corners that are certain enough and consistent with a plane board.

        Args:
            view: View of the board.
            fits: (M, COLUMNS) fits of all corners.
            motion_uv: (2,) motion of equal blur along u and v, squares; it adds to the standard deviations.
        """
        size = view.size_px(self._pattern.corners)  # (M,) of a square at each corner, px
        # (M,) px: noise of the pixels, from the residuals; then with errors of lens and print, and of the smear
        fit_sd = fits[:, saddle_points.RMS] * np.sqrt((fits[:, saddle_points.V_XX] + fits[:, saddle_points.V_YY]) / 2)
        sd = np.sqrt(fit_sd**2 + _CORNER_SD_PX**2 + (_SMEAR_SD * np.linalg.norm(motion_uv) * size) ** 2)
        distance = np.linalg.norm(fits[:, :2] - view.pixels(self._pattern.corners), axis=1)
        is_consistent = (distance < np.maximum(_FLATNESS * size, 5 * sd)) & (sd < _MAX_CORNER_SD * size)
        indices = np.flatnonzero((fits[:, saddle_points.OK] > 0) & is_consistent)
        return BoardFit(view=view, indices=indices, corners=fits[indices], sd_px=sd[indices])

    def _is_sufficient(self, fit: BoardFit, motion_uv: Array) -> bool:
        """Whether the accepted corners suffice; a smeared board resembles itself shifted and needs more.

        A sharp board needs `_MIN_CORNERS`. A smeared one needs a share of its corners and a small misfit, and must
        still be readable.

        Args:
            fit: View and accepted corners.
            motion_uv: (2,) motion of equal blur along u and v, squares, ≥ 0.
        """
        count, length = len(fit.indices), np.linalg.norm(motion_uv)
        if length <= _MAX_SHARP:
            return count >= _MIN_CORNERS
        many = count >= _SMEARED_SHARE * len(self._pattern.corners)
        return bool(many and _is_readable(motion_uv) and _median_misfit(fit.corners) < _SMEARED_MISFIT)

    def _possible_smears(self, blur: Array, motion: Array | None, sharp: Array) -> Iterator[Smear]:
        """The smears that explain the blur of the fitted corners equally well; all are tried.

        The first is the blur as it is. If the motion is not known and both families of edges are smeared, it may also
        be a motion along u and v of equal or of opposite signs; both are yielded.

        Args:
            blur: (2,) median blur of the fitted corners, squares.
            motion: (2,) known motion along u and v, squares; None: not known.
            sharp: (2,) blur at rest, squares.
        """
        yield Smear(blur=blur, motion=motion)
        motion_uv = Smear(blur=blur, motion=None).total_motion(sharp)
        if motion is None and motion_uv.min() > _MIN_SMEAR:
            for sense in (1.0, -1.0):
                yield Smear(blur=sharp, motion=motion_uv * (1.0, sense))

    def _fit_all_corners(self, grey: NDArray[np.uint8], view: View, smear: Smear, fit_blur: bool) -> Array:
        """(M, COLUMNS) fits of all corners; OK are those with little misfit and the usual step in brightness.

        None is OK if the usual step, the median, is too small.

        Args:
            grey: (H, W) image.
            view: View of the board, whose corners are where the fits begin.
            smear: Blur of the image.
            fit_blur: Whether the blur of each corner is fitted, from that of `smear` on; otherwise it is fixed.
        """
        corners, colour = self._pattern.corners, self._pattern.corner_colour
        motion = np.zeros(2) if smear.motion is None else smear.motion
        fits = saddle_points.fit_corners(
            grey, view.pixels(corners), view.edges(corners), colour, smear.blur, motion, fit_blur
        )
        step = fits[:, saddle_points.STEP]  # (M,) half the step in brightness
        good = (fits[:, saddle_points.OK] > 0) & (fits[:, saddle_points.RMS] < _MAX_MISFIT * step)
        usual = np.median(step[good]) if good.any() else 0.0
        fits[:, saddle_points.OK] = good & (step > _MIN_CONTRAST * usual) & (usual > _MIN_STEP)
        return fits

    def _is_identified(self, grey: NDArray[np.uint8], fit: BoardFit, near: Array | None, reach_px: float) -> bool:
        """Whether the identity of the corners is certain, by the prediction or by the whole board.

        Args:
            grey: (H, W) image.
            fit: View and accepted corners.
            near: (2,) predicted centre of the board, pixels; None without a prediction.
            reach_px: Largest error of the prediction, pixels.
        """
        if near is not None and is_unambiguous(self._pattern, fit.view, fit.indices, near, reach_px):
            return True
        levels = fit.corners[:, (saddle_points.MEAN, saddle_points.STEP)]
        return is_complete(grey, self._pattern, fit.view, self._pattern.corners[fit.indices], levels)


def _is_readable(motion_uv: Array) -> bool:
    """Whether a board that moves by (2,) squares ≥ 0 along u and v during the exposure keeps its pattern."""
    return bool(np.linalg.norm(motion_uv) <= _MAX_SMEAR and motion_uv.min() <= _MAX_STREAK)


def _median_misfit(fits: Array) -> float:
    """Median RMS residual over half the step in brightness, of the OK rows of (N, COLUMNS) fits; infinite for none."""
    good = fits[:, saddle_points.OK] > 0
    return float(np.median(fits[good, saddle_points.RMS] / fits[good, saddle_points.STEP])) if good.any() else np.inf
