"""StrideTwin: a digital twin of a person in a lower-limb exoskeleton, and the estimators that it scores.

The sub-packages are the folders at the top of the repository; this folder links to them. The public names are listed in
`__init__.pyi` and are imported when they are first used, so that `import stridetwin` loads neither MuJoCo nor Numba.
"""

import lazy_loader

from stridetwin import links as _links  # noqa: F401  refuses a copy without links

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
