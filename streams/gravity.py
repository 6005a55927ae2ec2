"""Gravity, m/s²; local gravity is a parameter of the estimators that need it closer than this."""

from __future__ import annotations

import math

STANDARD_GRAVITY_MPS2 = 9.80665
"""Standard gravity (3rd CGPM, 1901), the unit g of data sheets."""
NOMINAL_GRAVITY_MPS2 = 9.81
"""Gravity of the simulated world (MuJoCo's default), and of an unknown site."""

# WGS 84 (NGA.STND.0036, 2014): gravity at the equator, m/s²; Somigliana's constant; eccentricity squared; radius at the
# equator, m; flattening; and the ratio of centrifugal force to gravity at the equator
_AT_EQUATOR_MPS2 = 9.7803253359
_SOMIGLIANA = 0.00193185265241
_ECCENTRICITY_2 = 0.00669437999013
_RADIUS_M = 6378137.0
_FLATTENING = 1 / 298.257223563
_ROTATION = 0.00344978650684


def compute_normal_gravity(latitude_rad: float, height_m: float = 0.0) -> float:
    """Normal gravity of the WGS 84, m/s²: Somigliana's formula, with the free-air correction to second order.

    Real gravity differs from it by up to 0.003 m/s², by the masses of mountains and of the ground below.

    Args:
        latitude_rad: Geodetic latitude.
        height_m: Above the ellipsoid.
    """
    sin2 = math.sin(latitude_rad) ** 2
    at_ground = _AT_EQUATOR_MPS2 * (1 + _SOMIGLIANA * sin2) / math.sqrt(1 - _ECCENTRICITY_2 * sin2)
    radii = height_m / _RADIUS_M
    return at_ground * (1 - 2 * (1 + _FLATTENING + _ROTATION - 2 * _FLATTENING * sin2) * radii + 3 * radii**2)
