"""Model of a checkerboard, its view (a homography behind a lens), and the lens for both distortion models."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stridetwin.streams.errors import ConfigError
from stridetwin.streams.rig import Board, CameraCalibration
from stridetwin.streams.samples import Array

MODELS = ("radtan", "equidistant")
_FOLD_STEPS = 200  # samples of the search for the angle at which a distortion folds back
_TAN_MAX = 4.0  # no shoe camera sees farther off its axis than 76 degrees


class DistortionModel:
    """Projects rays (x / z, y / z in the optical frame) to pixels and back.

    Args:
        camera: Intrinsics and distortion.

    Attributes:
        size: (width, height) in pixels.
        focal_px: Mean focal length, pixels.
        reach: Largest length of a ray that the distortion maps one to one.

    Raises:
        ConfigError: An unknown distortion model.
    """

    def __init__(self, camera: CameraCalibration) -> None:
        """Raises ConfigError where the distortion model is unknown."""
        if camera.distortion_model not in MODELS:
            raise ConfigError(camera.topic, "distortion_model", camera.distortion_model, ", ".join(MODELS))
        self._fisheye = camera.distortion_model == "equidistant"
        # (3, 3) pinhole matrix, pixels; (4,) distortion: k1 to k4 of `equidistant`, k1, k2, p1, p2 of `radtan`
        self._K, self._D = camera.K, np.asarray(camera.distortion, dtype=float)
        self.size = (camera.width, camera.height)
        self.focal_px = (camera.intrinsics[0] + camera.intrinsics[1]) / 2
        # rays along x of growing length: the first one after which the distorted length no longer grows is the reach
        r = np.linspace(0.0, _TAN_MAX, _FOLD_STEPS)
        distorted = self._distort(np.column_stack([r, np.zeros_like(r)]))[:, 0]
        falls = np.diff(distorted) <= 0
        self.reach = float(r[falls.argmax()]) if falls.any() else _TAN_MAX

    def pixels(self, rays: ArrayLike) -> Array:
        """(N, 2) pixels of (N, 2) rays; NaN beyond `reach`, where the polynomial folds the world back."""
        rays = np.asarray(rays, dtype=float)
        fu, fv, pu, pv = self._K[0, 0], self._K[1, 1], self._K[0, 2], self._K[1, 2]
        pixels = self._distort(rays) * (fu, fv) + (pu, pv)
        within_reach = np.einsum("ij,ij->i", rays, rays) <= self.reach**2  # squared lengths; False for NaN
        pixels[~within_reach] = np.nan
        return pixels

    def rays(self, pixels: ArrayLike) -> Array:
        """(N, 2) rays of (N, 2) pixels, without distortion: x / z and y / z in the optical frame."""
        pixels = np.ascontiguousarray(pixels, dtype=float).reshape(-1, 1, 2)
        undistort = cv2.fisheye.undistortPoints if self._fisheye else cv2.undistortPoints
        return np.asarray(undistort(pixels, self._K, self._D), dtype=float).reshape(-1, 2)

    def _distort(self, rays: Array) -> Array:
        """(N, 2) distorted rays of (N, 2) rays, in units of the focal length from the principal point.

        Kannala & Brandt 2006 for `equidistant`, Brown 1966 for `radtan`.
        """
        x, y = rays[:, 0], rays[:, 1]
        r2 = x * x + y * y
        if self._fisheye:
            r = np.sqrt(r2)
            angle = np.arctan(r)  # between ray and optical axis, rad
            a2 = angle * angle
            k1, k2, k3, k4 = self._D
            distorted_r = angle * (1 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))))
            scale = np.divide(distorted_r, r, out=np.ones_like(r), where=r > 1e-9)  # 1 on the axis, where r is 0
            return rays * scale[:, None]
        k1, k2, p1, p2 = self._D
        radial = 1 + r2 * (k1 + r2 * k2)
        distorted_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        distorted_y = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.column_stack([distorted_x, distorted_y])


MARGIN = 1
"""White squares around the printed ones; they distinguish a board from the same board shifted by two squares."""
_AHEAD = 0.05  # least homography scale, relative to the centre, of a point in front of the camera


class BoardPattern:
    """Corners and cells of a board, in squares from its centre, along its x (u) and y (v).

    The square at the least u and v is dark, and a white margin of at least one square surrounds the print.

    Args:
        board: Number of squares and their size.

    Attributes:
        shape: (columns, rows) of interior corners.
        square_m: Edge of a square, m.
        corners: (M, 2), v slowest.
        corner_colour: (M,) +1 where the square at +u, +v of the corner is bright, -1 where it is dark.
        cells: (C, 2) centres of the squares and of as many cells of the margin as surround them, v slowest.
        bright: (rows + 2, columns + 2), for a board of so many rows and columns of squares: +1 where a cell is bright,
            -1 where it is dark.

    Raises:
        ConfigError: Fewer than 3 squares along an edge, or an edge that is the same from both ends.
    """

    def __init__(self, board: Board) -> None:
        """Raises ConfigError where the board has too few squares, or looks the same from both ends."""
        columns, rows = board.squares
        if min(columns, rows) < 3 or (columns + rows) % 2 == 0:
            raise ConfigError(
                f"board {board.name}", "squares", board.squares, "3 or more each way, one even and one odd"
            )
        self.square_m = board.square_m
        self.shape = (columns - 1, rows - 1)
        self.corners = lattice(columns - 1, rows - 1)
        # the square at +u, +v of the first corner is the second one along the board's diagonal, and dark as the first
        self.corner_colour = -_checker(columns - 1, rows - 1).ravel()
        self.cells = lattice(columns + 2 * MARGIN, rows + 2 * MARGIN)
        self.bright = np.pad(-_checker(columns, rows), MARGIN, constant_values=1.0)  # the first square is dark

    @property
    def points_in_board(self) -> Array:
        """(M, 3) corners in the board's frame, m."""
        return np.column_stack([self.corners * self.square_m, np.zeros(len(self.corners))])


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """View of a board.

    Attributes:
        lens: Lens of the camera.
        H: (3, 3) homography from squares to rays; the last coordinate is positive in front of the camera.
    """

    lens: DistortionModel
    H: Array

    @classmethod
    def from_points(cls, lens: DistortionModel, squares: Array, rays: Array, tolerance: float = 0.0) -> View | None:
        """The view that maps points of a board to their rays; None if none does, or if it shows the board from behind.

        Args:
            lens: Lens of the camera.
            squares: (N, 2) points, in squares from the board's centre; fewer than 4 determine no view.
            rays: (N, 2) rays of the points.
            tolerance: Largest error of an inlier (RANSAC), in units of a ray; 0: all points are inliers.
        """
        if len(squares) < 4:
            return None
        method, limit = (cv2.RANSAC, tolerance) if tolerance else (0, 3.0)  # method 0: least squares, limit not used
        H, _ = cv2.findHomography(squares, rays, method, limit)
        if H is None or not np.isfinite(H).all():
            return None
        H = H * np.sign(H[2, 2])  # the board's centre is in front of the camera
        seen_from_front = np.linalg.det(H) < 0  # z of the board points at the camera
        return cls(lens=lens, H=H) if seen_from_front else None

    def shift(self, u: float, v: float) -> View:
        """The view of a board that is moved by (u, v) squares along its own axes.

        A point (x, y) of the moved board is where the point (x + u, y + v) of this view is.
        """
        return View(lens=self.lens, H=self.H @ np.array([[1.0, 0.0, u], [0.0, 1.0, v], [0.0, 0.0, 1.0]]))

    def rays(self, squares: Array) -> Array:
        """(N, 2) rays of (N, 2) points in squares; NaN behind the camera."""
        # homogeneous coordinates; the last one counts relative to that of the board's centre
        p = squares @ self.H[:, :2].T + self.H[:, 2]
        ahead = p[:, 2] > _AHEAD * self.H[2, 2]
        divisor = np.where(ahead, p[:, 2], 1.0)  # 1 avoids a division by 0 where the result is NaN anyway
        return np.where(ahead[:, None], p[:, :2], np.nan) / divisor[:, None]

    def pixels(self, squares: Array) -> Array:
        """(N, 2) pixels of (N, 2) points in squares; NaN behind the camera, and beyond the reach of its lens."""
        return self.lens.pixels(self.rays(squares))

    def edges(self, squares: Array) -> Array:
        """The vectors from one square to the next at points of the board.

        Args:
            squares: (N, 2) points, in squares from the board's centre.

        Returns:
            (N, 2, 2) pixels: along u in the first row, along v in the second, as central differences over one square.
        """
        n, half = len(squares), 0.5
        # half a square from each point: toward +u, -u, +v and -v
        ends = np.concatenate([squares + offset for offset in ((half, 0), (-half, 0), (0, half), (0, -half))])
        u_end, u_start, v_end, v_start = self.pixels(ends).reshape(4, n, 2)
        return np.stack([u_end - u_start, v_end - v_start], axis=1)

    def to_squares(self, way_px: Array) -> Array:
        """(2,) motion along u and v in squares, of a short motion `way_px` (2,) in pixels at the board's centre.

        NaN where the board is seen edge-on.
        """
        # way_px = a u + b v for the edges u and v of a square, px: a and b by Cramer's rule
        u, v = self.edges(np.zeros((1, 2)))[0]
        area = u[0] * v[1] - u[1] * v[0]
        along = [way_px[0] * v[1] - way_px[1] * v[0], u[0] * way_px[1] - u[1] * way_px[0]]
        return np.array(along) / (area if abs(area) > 0 else np.nan)

    def size_px(self, squares: Array) -> Array:
        """(N,) size of a square at (N, 2) points, pixels: the square root of its area in the image."""
        u, v = self.edges(squares).transpose(1, 2, 0)  # (2, N) each: x and y of the edges of a square
        return np.sqrt(np.abs(u[0] * v[1] - u[1] * v[0]))


def sample(image: NDArray[np.uint8], pixels: Array) -> NDArray[np.float32]:
    """(N,) brightness at (N, 2) pixels, bilinear; NaN outside the image."""
    height, width = image.shape
    inside = np.all((pixels >= 0) & (pixels <= np.array([width - 1, height - 1])), axis=1)  # false for NaN as well
    # (N, 1, 2) places to read; outside the image any valid one, as the result is NaN there
    at = np.where(inside[:, None], pixels, 0.0).astype(np.float32).reshape(-1, 1, 2)
    grey = cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE).ravel()
    return np.where(inside, grey, np.nan).astype(np.float32)


def lattice(columns: int, rows: int) -> Array:
    """(rows * columns, 2) points one square apart around the board's centre, u fastest."""
    v, u = np.mgrid[:rows, :columns].astype(float)
    return np.column_stack([u.ravel() - (columns - 1) / 2, v.ravel() - (rows - 1) / 2])


def _checker(columns: int, rows: int) -> Array:
    """(rows, columns) checkerboard of +1 and -1, with +1 at the least u and v."""
    v, u = np.mgrid[:rows, :columns]
    return 1.0 - 2.0 * ((u + v) % 2)
