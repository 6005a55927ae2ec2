"""Gravity, m/s²; local gravity is a parameter of the estimators that need it closer than this."""

STANDARD_GRAVITY_MPS2 = 9.80665
"""Standard gravity (3rd CGPM, 1901), the unit g of data sheets."""
NOMINAL_GRAVITY_MPS2 = 9.81
"""Gravity of the simulated world (MuJoCo's default), and of an unknown site."""
