from dataclasses import replace

import numpy as np
import pytest
import torch

pytest.importorskip("mujoco", reason="needs the extra 'sim'")

import mujoco

from torch_geometric_tactile.sensors import HandKinematics, TaxelLayout, allegro_uskin
from torch_geometric_tactile.sim import (
    ContactParameters,
    grasp_mjcf,
    paper8,
)
from torch_geometric_tactile.sim._grasp import GraspSimulator
from torch_geometric_tactile.sim.hand_model import stock_bodies

LAYOUT, HAND, ITEM = allegro_uskin(), HandKinematics.allegro(), paper8()[0]
ROD = TaxelLayout(
    "rod",
    pos=torch.tensor([[0.01, 0.0, 0.0], [0.0, 0.01, 0.02]]),
    normal=torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]]),
    link=[0, 1],
    link_names=("palm_link", "link_3_tip"),
)


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(grasp_mjcf(LAYOUT, HAND, ITEM))


def test_model_has_every_taxel_joint_and_actuator(model):
    names = {model.geom(i).name for i in range(model.ngeom)}
    assert {f"taxel_{i}" for i in range(384)} <= names
    assert {f"bone_{body['link']}" for body in stock_bodies()} <= names
    assert model.nu == 4 + 16
    assert [model.actuator(i).trnid[0] for i in range(4, 20)] == [
        model.joint(name).id for name in HAND.joint_names
    ]


@pytest.mark.parametrize("seed", range(3))
def test_simulated_and_computed_taxels_agree(model, seed):
    draw = np.random.default_rng(seed)
    joint = draw.uniform(HAND.lower.numpy(), HAND.upper.numpy())
    data = mujoco.MjData(model)
    data.qpos[[model.joint(name).qposadr[0] for name in HAND.joint_names]] = joint
    for name in ("x", "y", "z", "yaw"):
        data.qpos[model.joint(f"gantry_{name}").qposadr[0]] = draw.normal()
    mujoco.mj_forward(model, data)
    palm = model.body("palm_link").id
    turn = data.xmat[palm].reshape(3, 3)
    sites = np.array([data.site(f"taxel_{i}").xpos for i in range(384)])
    pose = HAND.taxel_pose(LAYOUT, torch.from_numpy(joint))
    assert np.abs((sites - data.xpos[palm]) @ turn - pose.pos.numpy()).max() < 1e-6
    # The spheres touch the skin from within: a radius behind the taxel, against its normal.
    spheres = np.array([data.geom(f"taxel_{i}").xpos for i in range(384)])
    normal = (sites - spheres) @ turn / ContactParameters().taxel_radius
    assert np.abs(normal - pose.normal.numpy()).max() < 1e-4


def test_links_have_the_masses_of_the_table(model):
    for body in stock_bodies():
        assert model.body(body["link"]).mass[0] == pytest.approx(body["mass"], rel=1e-9)
    assert model.body("object").mass[0] == ITEM.mass


def test_layout_of_fewer_taxels():
    simulator = GraspSimulator(ROD, HAND, ITEM)
    taxels = [simulator.model.geom(f"taxel_{i}") for i in range(2)]
    bodies = [simulator.model.body(int(taxel.bodyid[0])).name for taxel in taxels]
    assert bodies == ["palm_link", "link_3_tip"]
    force, bones, support = simulator.forces()
    assert force.tolist() == [[0, 0, 0], [0, 0, 0]]
    assert bones == 0
    assert support.tolist() == [0, 0, 0]


def test_bad_layouts_are_named():
    with pytest.raises(ValueError, match=r"must have the links of layout 'odd'.*'toe'"):
        grasp_mjcf(replace(ROD, name="odd", link_names=("palm_link", "toe")), HAND, ITEM)
    with pytest.raises(ValueError, match=r"layout 'rod' must have normals \(got none\)"):
        grasp_mjcf(replace(ROD, normal=None), HAND, ITEM)


def test_missing_mujoco_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'torch-geometric-tactile\[sim\]'"):
        GraspSimulator(ROD, HAND, ITEM)
