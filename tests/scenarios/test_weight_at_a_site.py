"""Forces as shares of a weight: of that which the walker has at the site of the walk."""

import numpy as np
import pytest
from fake_twin import FakeTwin

from stridetwin.cli.main import main
from stridetwin.report import runner
from stridetwin.scenarios import record
from stridetwin.scenarios.campaign import walk as campaign_walk
from stridetwin.scenarios.campaign.campaign_file import read_campaign
from stridetwin.scenarios.campaign.generate import CampaignOptions, generate
from stridetwin.scenarios.scenario_file import read_scenario
from stridetwin.streams.gravity import NOMINAL_GRAVITY_MPS2
from stridetwin.streams.samples import Block, Wrench
from tests.plots import figures

PUSH_N, LOAD_N = 7000.0, 370.0
"""Force at the pelvis, large enough to show gravity in a text of two decimals, and that under a foot in stance."""
WALK = """
description: a walk
terrain:
  - level: {length_m: 5}
sensors: [foot_imu, insole]
physics: dynamic
"""
SITES = {"nowhere": ("", NOMINAL_GRAVITY_MPS2), "quito": ("site: {latitude_deg: -0.2, height_m: 2850}\n", 9.7716)}


class PushedTwin(FakeTwin):
    def blocks(self):
        for blocks in super().blocks():
            t_ns = blocks[0].t_ns
            force = np.tile([PUSH_N, 0.0, 0.0], (len(t_ns), 1))
            columns = {"force_in_world": force, "torque_in_world": 0 * force}
            yield [*blocks, Block(topic="/truth/root_residual", kind=Wrench, t_ns=t_ns, columns=columns)]


@pytest.fixture(params=SITES)
def place(request, tmp_path):
    """File of a scenario, and the weight of its walker there."""
    text, gravity_mps2 = SITES[request.param]
    path = tmp_path / "walk.yaml"
    path.write_text(WALK + text)
    config = read_scenario(path).config
    assert config.gravity_mps2 == pytest.approx(gravity_mps2, abs=1e-4)
    return path, config.person.mass_kg * config.gravity_mps2


def test_a_report_divides_forces_by_the_weight_at_the_site(place, monkeypatch):
    path, weight_n = place
    for module in (record, runner):
        monkeypatch.setattr(module, "make_twin", lambda scenario, seed: PushedTwin(scenario.config, seed))
    folder = path.parent / "out"
    assert main(["run", str(path), "--no-film", "--no-cameras", "--only", "foot_ins", "-o", str(folder)]) == 0
    html = (folder / "report.html").read_text()
    assert f"external force at the pelvis {100 * PUSH_N / weight_n:.2f} % of body weight" in html
    (load,) = {curve[:, 1].max() for curve in figures(html)["Vertical ground reaction"].shapes("left strides")}
    assert load == pytest.approx(LOAD_N / weight_n, rel=1e-4)


def test_a_campaign_divides_forces_by_the_weight_at_the_site(place, monkeypatch):
    path, weight_n = place
    monkeypatch.setattr(campaign_walk, "twin_class", lambda: PushedTwin)
    campaign = path.parent / "one.yaml"
    campaign.write_text("campaign: One\nwalks: 1\nscenarios: [walk.yaml]\n")
    done = generate(read_campaign(campaign), CampaignOptions(folder=path.parent / "out"), lambda *_: None)
    (row,) = done.manifest["walks"]
    assert row["help_mean_pct"] == pytest.approx(100 * PUSH_N / weight_n, abs=1e-3)
