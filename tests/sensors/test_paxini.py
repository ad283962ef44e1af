import pytest
import torch

from torch_geometric_tactile.io import PaXiniDecoder
from torch_geometric_tactile.sensors import (
    HandKinematics,
    as_layout,
    leap_paxini,
    paxini_15_pulp,
    paxini_15_tip,
    paxini_31,
    paxini_52,
)


def pairs(layout):
    return set(map(tuple, layout.edge_index("original").t().tolist()))


@pytest.mark.parametrize(
    ("build", "number", "point", "millimetres"),
    [
        (paxini_15_tip, 15, 9, (0.0, 24.5052, -2.49584)),
        (paxini_15_pulp, 15, 14, (4.7, 21.3, 2.94543)),
        (paxini_31, 31, 30, (5.667686, 6.215905, 1.937766)),
        (paxini_52, 52, 29, (0.0, 19.326163, 1.937773)),
    ],
)
def test_points_at_the_places_of_their_source(build, number, point, millimetres):
    layout = build()
    assert layout.num_taxels == number
    assert (layout.pos[point] * 1e3).tolist() == pytest.approx(millimetres, abs=1e-5)
    assert "MIT" in layout.source
    assert "https://" in layout.source
    assert as_layout(build.__name__).matches(layout)


@pytest.mark.parametrize(("build", "millimetres"), [(paxini_31, 4.2), (paxini_52, 4.0)])
def test_edges_join_what_is_near(build, millimetres):
    layout = build()
    distance = torch.cdist(layout.pos, layout.pos).fill_diagonal_(1.0) * 1e3
    near = (distance < millimetres).nonzero().tolist()
    assert pairs(layout) == set(map(tuple, near))


@pytest.mark.parametrize("build", [paxini_31, paxini_52])
def test_edges_reach_every_point(build):
    layout = build()
    reached = torch.zeros(len(layout), dtype=torch.bool)
    reached[0] = True
    source, target = layout.edge_index("original")
    for _ in range(len(layout)):
        reached[target[reached[source]]] = True
    assert reached.all()


@pytest.mark.parametrize("build", [paxini_15_tip, paxini_15_pulp, paxini_52])
def test_pads_are_mirrored_in_x(build):
    pos = build().pos
    mirrored = pos * torch.tensor([-1.0, 1.0, 1.0])
    distance = (pos[:, None] - mirrored).norm(dim=2)
    assert distance.amin(dim=1).max() < 1e-7


def test_edges_of_15_points_are_neighbours_in_the_image():
    layout = paxini_15_tip()
    distance = torch.cdist(layout.image_map.float(), layout.image_map.float(), p=1)
    assert pairs(layout) == set(map(tuple, (distance == 1).nonzero().tolist()))
    assert layout.image_map.amax(dim=0).tolist() == [4, 2]


def test_leap_hand_by_hand():
    layout = leap_paxini()
    assert repr(layout) == "TaxelLayout('leap_paxini', num_taxels=120, patches=8, digits=4)"
    # The first point of the index fingertip: place of the module, and -z, -y, -x of the point.
    place = torch.tensor([-0.01553, -0.01398, 0.01592])
    point = torch.tensor([-2.97814, -4.30109, 4.5]) * 1e-3
    assert torch.allclose(layout.pos[30], place + point)
    assert layout.link_names[int(layout.link[30])] == "fingertip"
    assert layout.patch_names[int(layout.patch[30])] == "index_tip"
    source, target = layout.edge_index("original")
    assert len(source) == 8 * 44
    assert layout.patch[source].equal(layout.patch[target])


def test_modules_of_the_leap_hand_are_paxinis():
    layout = leap_paxini()
    for name, module in (("ring_tip", paxini_15_tip()), ("thumb_pulp", paxini_15_pulp())):
        pos = layout.pos[layout.patch == layout.patch_names.index(name)]
        expected = torch.cdist(module.pos, module.pos)
        assert torch.allclose(torch.cdist(pos, pos), expected, atol=1e-6)


def test_leap_hand_is_posed_by_a_urdf_with_its_links(tmp_path):
    layout = leap_paxini()
    links = [f'<link name="{name}"/>' for name in ("palm_lower", *layout.link_names)]
    joints = [
        f'<joint name="{number}" type="revolute"><parent link="palm_lower"/><child link="{name}"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint>'
        for number, name in enumerate(layout.link_names)
    ]
    path = tmp_path / "leap.urdf"
    path.write_text(f'<robot name="leap">{"".join(links + joints)}</robot>')
    hand = HandKinematics.from_urdf(path)
    assert hand.taxel_pose(layout, torch.zeros(7)).pos.allclose(layout.pos)


def test_decoder_names_the_layout_of_a_single_module():
    assert PaXiniDecoder().layout == "paxini_52"
    assert PaXiniDecoder((31,)).layout == "paxini_31"
    assert PaXiniDecoder((15,)).layout is None
    assert PaXiniDecoder((52, 52)).layout is None
