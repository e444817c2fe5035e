"""A robot finds its parts, moves, and says what is wrong with what it is given."""

import mujoco
import numpy as np
import pytest

from prioritized_ik import InputError, Robot
from prioritized_ik.errors import ModelError

XML = """
<mujoco><worldbody><body name="hand"><joint name="turn" type="ball"/><geom size="0.1"/>
<body name="finger" pos="0 0 .2"><joint name="bend" axis="0 1 0"/><geom name="tip" size="0.05"/><site name="nail"/></body>
</body></worldbody></mujoco>
"""


@pytest.fixture
def robot() -> Robot:
    return Robot(mujoco.MjModel.from_xml_string(XML))


def test_parts_are_found_by_name_and_by_number(robot):
    assert (robot.joint("bend"), robot.body("finger"), robot.site("nail"), robot.geom(0)) == (1, 2, 0, 0)
    assert robot.names("geom") == ["geom 0", "tip"]
    assert robot.dofs("bend") == slice(3, 4)


def test_an_unknown_name_lists_what_there_is_nearest_first(robot):
    with pytest.raises(InputError, match=r"no joint 'bent'; the model has 2 joints: bend, turn; 3 bodies: "):
        robot.joint("bent")
    with pytest.raises(InputError, match=r"no geom 7; the model has 2 geoms: tip, 1 without a name, by number; "):
        robot.geom(7)


def test_a_frame_that_does_not_exist_lists_every_kind_nearest_first(robot):
    listed = (
        r"1 site: nail; 2 joints: turn, bend; 3 bodies: finger, world, hand; 2 geoms: tip, 1 without a name, by number\."
    )
    with pytest.raises(InputError, match="no site 'fingre'; the model has " + listed):
        robot.frame(site="fingre")


def test_a_keyframe_is_a_position_by_name_or_number():
    keys = '<keyframe><key name="home" qpos="1 0 0 0 0.5"/><key qpos="0 1 0 0 0"/></keyframe></mujoco>'
    robot = Robot(mujoco.MjModel.from_xml_string(XML.replace("</mujoco>", keys)))
    robot.update(robot.keyframe("home"))
    assert robot.q.tolist() == [1.0, 0.0, 0.0, 0.0, 0.5] == robot.keyframe(0).tolist()
    assert robot.keyframe(1).tolist() == [0.0, 1.0, 0.0, 0.0, 0.0]
    with pytest.raises(
        InputError, match=r"no keyframe 'hom'; the model has 2 keyframes: home, 1 without a name, by number\."
    ):
        robot.keyframe("hom")


def test_a_truth_value_is_no_number_of_a_part(robot):
    with pytest.raises(InputError, match="no body True"):
        robot.body(True)


def test_long_lists_are_cut():
    geoms = "".join(f'<geom name="g{i}" size="1"/>' for i in range(30))
    robot = Robot(mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{geoms}</worldbody></mujoco>"))
    with pytest.raises(InputError, match=r"30 geoms: g29, .*, 10 more; no joint; 1 body: world; no site"):
        robot.geom("g299")


def test_a_pattern_finds_all_that_match(robot):
    assert robot.joints("*n*") == [0, 1]
    assert robot.bodies("*") == [0, 1, 2]
    assert robot.sites("n?il") == [0]
    assert robot.geoms("t*") == [1]
    assert robot.geoms(0) == [0]
    with pytest.raises(InputError, match=r"no geom 'x\*'"):
        robot.geoms("x*")


def test_integrating_turns_a_ball_joint_on_its_sphere(robot):
    q = robot.integrate([0.0, 0.0, 1.0, 0.5], 0.2)
    assert q == pytest.approx([np.cos(0.1), 0.0, 0.0, np.sin(0.1), 0.1])
    assert robot.q == pytest.approx(q)


def test_a_position_of_the_wrong_length_says_nq_and_nv(robot):
    with pytest.raises(InputError, match="nq = 5 positions and nv = 4"):
        robot.update(np.zeros(4))


def test_one_frame_is_asked_for_at_a_time(robot):
    with pytest.raises(InputError, match="2 frames were given"):
        robot.frame(site="nail", body="hand")


def test_a_urdf_of_package_paths_is_refused(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text('<robot name="r"><link name="a"><visual><mesh filename="package://x/a.stl"/></visual></link></robot>')
    with pytest.raises(InputError, match=r"^robot\.urdf has package:// paths"):
        Robot(file)


@pytest.mark.parametrize("name", ["robot.urdf", "robot.xml", "robot.urdf.xacro"])
def test_a_urdf_of_xacro_is_told_to_be_expanded_whatever_it_is_called(tmp_path, name):
    file = tmp_path / name
    file.write_text('<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="l"/><link name="a"/></robot>')
    with pytest.raises(InputError, match=f"^{name} has xacro in it; expand it first: xacro {name} > robot.urdf"):
        Robot(file)


def test_a_urdf_that_is_called_xml_keeps_its_fixed_links(tmp_path):
    file = tmp_path / "robot.xml"
    links = '<link name="a"/><link name="tool0"/>'
    fixed = '<joint name="f" type="fixed"><parent link="a"/><child link="tool0"/></joint>'
    file.write_text(f'<robot name="r">{links}{fixed}</robot>')
    assert Robot(file).names("body") == ["world", "a", "tool0"]


def test_mjcf_that_is_no_strict_xml_loads_as_mujoco_reads_it(tmp_path):
    file = tmp_path / "robot.xml"
    file.write_text('<!-- -- a rule -- --><mujoco><worldbody><body name="b"><geom size="1"/></body></worldbody></mujoco>')
    assert Robot(file).names("body") == ["world", "b"]


def test_a_urdf_loads(tmp_path):
    file = tmp_path / "robot.urdf"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    file.write_text(
        f'<robot name="r"><link name="a"/><link name="b">{inertial}</link><joint name="j" type="continuous">'
        '<parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    assert Robot(file).names("joint") == ["j"]


def test_a_missing_or_broken_file_is_one_clear_message(tmp_path):
    with pytest.raises(InputError, match="there is no file"):
        Robot(tmp_path / "none.xml")
    (tmp_path / "broken.xml").write_text("<mujoco>")
    with pytest.raises(InputError, match=r"cannot read broken\.xml"):
        Robot(tmp_path / "broken.xml")


BARE = """<robot name="bare">
  <link name="base"/>
  <link name="arm"><visual><geometry><box size="0.1 0.1 0.4"/></geometry></visual></link>
  <link name="tool"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="weld" type="fixed"><parent link="arm"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>
</robot>"""


def urdf(folder, text):
    file = folder / "bare.urdf"
    file.write_text(text, encoding="utf-8")
    return Robot(file)


def test_links_of_a_urdf_without_mass_load_and_its_fixed_links_can_be_named(tmp_path):
    robot = urdf(tmp_path, BARE)
    assert robot.names("body") == ["world", "base", "arm", "tool"]
    np.testing.assert_allclose(robot.position(robot.frame(body="tool")), [0.0, 0.0, 0.4])
    assert robot.names("joint") == ["turn"]


def test_the_shapes_of_a_urdf_are_those_to_collide_with_or_else_those_to_look_at(tmp_path):
    assert urdf(tmp_path, BARE).model.ngeom == 1
    ball = "<collision><geometry><sphere radius='0.1'/></geometry></collision></link>"
    both = urdf(tmp_path, BARE.replace("</visual></link>", f"</visual>{ball}"))
    assert [int(kind) for kind in both.model.geom_type] == [int(mujoco.mjtGeom.mjGEOM_SPHERE)]


def test_what_a_urdf_itself_tells_mujoco_counts(tmp_path):
    own = "<mujoco><compiler fusestatic='true' discardvisual='true'/></mujoco></robot>"
    robot = urdf(tmp_path, BARE.replace("</robot>", own))
    assert robot.names("body") == ["world", "arm"]
    assert robot.model.ngeom == 0


def test_meshes_of_a_urdf_are_found_beside_it_and_in_folders_beside_it(tmp_path):
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], dtype="<f4")
    faces = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    content = bytes(80) + np.uint32(4).tobytes()
    content += b"".join(bytes(12) + corners[list(face)].tobytes() + bytes(2) for face in faces)
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "tip.stl").write_bytes(content)
    shape = "<visual><geometry><mesh filename='meshes/tip.stl'/></geometry></visual>"
    assert urdf(tmp_path, BARE.replace('<link name="tool"/>', f'<link name="tool">{shape}</link>')).model.nmesh == 1


def test_a_urdf_that_is_no_xml_is_one_error(tmp_path):
    with pytest.raises(ModelError, match=r"cannot read bare.urdf: no element found"):
        urdf(tmp_path, "")
