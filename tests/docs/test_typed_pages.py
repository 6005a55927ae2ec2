"""The Python files that pages show, and the example package, satisfy `mypy --strict` outside the repository."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.import_statements import find_imports
from tools.tutorial import ROOT, blocks

EXAMPLES = ROOT / "tests" / "run" / "example_package"
FITS = """
from stridetwin.estimators.base import Estimator
from stridetwin.estimators.locomotion_mode import ModeEstimate
from stridetwin.estimators.terrain_map import TerrainEstimate
from stridetwin.streams.samples import Depth, Imu, Insole, Odometry, Sample
from stridetwin.streams.trajectory import Pose
from stridetwin_example import GravityFoot
from stridetwin_example_ground import FlatGround, SteadySteps

foot: type[Estimator[Imu, Pose]] = GravityFoot
ground: type[Estimator[Sample, TerrainEstimate]] = FlatGround
steps: type[Estimator[Sample, ModeEstimate]] = SteadySteps
"""
DOES_NOT_FIT = """
from stridetwin.estimators.base import Estimator
from stridetwin.streams.samples import Imu
from stridetwin.streams.trajectory import Pose
from stridetwin_example_ground import FlatGround

foot: type[Estimator[Imu, Pose]] = FlatGround
"""
UNUSED = [
    "IPython",
    "PIL",
    "av",
    "cv2",
    "dash",
    "distributed",
    "dm_control",
    "llvmlite",
    "mujoco",
    "numba",
    "open3d",
    "pandas",
    "plotly",
    "prompt_toolkit",
    "rerun",
    "rich",
    "rosbags",
    "scipy.integrate",
    "scipy.interpolate",
    "scipy.io",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "sklearn",
    "trimesh",
]
"""Libraries of ours that no page's code imports: reading them takes mypy longer than all the rest."""
CONFIG = f"""
[mypy]
strict = true
[mypy-{",".join(f"{name},{name}.*" for name in UNUSED)}]
follow_imports = skip
follow_imports_for_stubs = true
"""


def check_types(folder: Path) -> list[str]:
    """Lines of `mypy --strict` about the files of a folder, all in one run, as most of it is about libraries."""
    (folder / "mypy.ini").write_text(CONFIG, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--config-file", "mypy.ini", "--no-incremental", "--no-error-summary"]
    done = subprocess.run(
        [*command, *sorted(file.name for file in folder.glob("*.py"))],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT), "MYPYPATH": ""},  # as if it were installed
        capture_output=True,
        text=True,
        timeout=1200,
    )
    assert not done.stderr, done.stderr
    return done.stdout.splitlines()


@pytest.fixture
def folder(tmp_path):
    """A folder with the Python files of the pages and of the example package."""
    for page in sorted((ROOT / "docs").glob("*.md")):
        for block in blocks(page.read_text(encoding="utf-8")):
            if block.language == "python" and block.file:
                assert not (tmp_path / block.file).exists(), f"{page.name}: another page has a {block.file}"
                (tmp_path / block.file).write_text(block.text, encoding="utf-8")
    for file in EXAMPLES.glob("*.py"):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def test_code_of_the_pages_is_typed_strictly_and_a_class_of_another_kind_is_found(folder):
    assert {"my_foot.py", "test_my_foot.py", "test_my_foot_conforms.py"} <= {file.name for file in folder.iterdir()}
    for file in folder.glob("*.py"):
        for statement in find_imports(file.read_text(encoding="utf-8")):
            assert not [name for name in UNUSED if re.search(rf"\b{re.escape(name)}\b", ast.unparse(statement))]
    (folder / "fits.py").write_text(FITS, encoding="utf-8")
    (folder / "does_not_fit.py").write_text(DOES_NOT_FIT, encoding="utf-8")
    error, *notes = check_types(folder)
    assert error.startswith("does_not_fit.py:")
    assert 'variable has type "type[Estimator[Imu, Pose]]"' in error
    assert [note for note in notes if not re.match(r"does_not_fit\.py:\d+: note: ", note)] == []
