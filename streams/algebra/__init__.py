"""Rotations, vectors and small systems of equations, for the simulation and the estimators.

- `arrays`: NumPy, for stacks of any size; imports nothing slow.
- `tuples`: compiled, vectors, unit quaternions and 3 × 3 matrices as tuples, which the compiler keeps in registers.
- `matrices`: compiled, arrays: rotation matrices one at a time, matrices of any size, linear equations.

They share one vocabulary: `exp` and `log` between rotation vectors (rad) and rotations, `identity`, `inverse`,
`multiply`, `apply` to a vector, `from_...` and `to_...` between representations. Rotations are active and act on the
left: R_ab takes a vector from b to a. Quaternions are Hamilton's, w x y z.
"""
