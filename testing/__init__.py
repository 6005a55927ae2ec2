"""Conformance of estimators: checks that any estimator must pass, for the tests of its author and for `conform`."""

from stridetwin.testing.cases import Case, Verdict, check_conformance, conformance_cases
from stridetwin.testing.subject import ConformanceError

__all__ = ["Case", "ConformanceError", "Verdict", "check_conformance", "conformance_cases"]
