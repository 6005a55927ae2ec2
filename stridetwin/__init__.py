"""StrideTwin: a digital twin of a person in a lower-limb exoskeleton, and the estimators that it scores.

The sub-packages are the folders at the top of the repository; this folder links to them.
"""
