import pytest

from stridetwin.gate import bootstrap


@pytest.fixture(autouse=True)
def few_draws(monkeypatch):
    """As many as the dozen scores of these tests need."""
    monkeypatch.setattr(bootstrap, "DRAWS", 5000)
