"""A small MuJoCo model with one geom of each kind, turned its own way, and some that nobody is to see."""

from pathlib import Path

MESH_EULER_DEG = (20.0, 10.0, 50.0)
MESH_POS_M = (0.3, -0.1, 0.0)
MESH_VERTICES_M = ((0, 0, 0), (0.2, 0, 0), (0, 0.2, 0), (0, 0, 0.3), (0.1, 0.1, 0.1))
FLOOR_M = -0.2
THINGS = f"""
<mujoco>
  <asset>
    <mesh name="rock" vertex="{"  ".join(" ".join(map(str, vertex)) for vertex in MESH_VERTICES_M)}"/>
    <material name="red" rgba=".8 .2 .2 1"/>
  </asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1" pos="0 0 {FLOOR_M}"/>
    <body name="base" pos="0 0 .3" euler="10 20 30">
      <joint name="turn" type="hinge" axis="0 0 1" range="-90 90" limited="true"/>
      <geom name="tin" type="cylinder" size=".05 .15" pos="0 .3 0" euler="40 0 10" rgba=".2 .7 .3 1"/>
      <geom name="pill" type="capsule" size=".04 .12" euler="0 70 10" rgba=".2 .3 .8 1"/>
      <geom name="egg" type="ellipsoid" size=".05 .1 .15" pos="0 -.3 0" euler="30 10 0" material="red"/>
      <geom name="brick" type="box" size=".05 .1 .02" pos=".3 .3 0" euler="30 50 0"/>
      <geom name="rock" type="mesh" mesh="rock" pos="{" ".join(map(str, MESH_POS_M))}"
            euler="{" ".join(map(str, MESH_EULER_DEG))}" rgba=".9 .8 .2 1"/>
      <geom name="ball" type="sphere" size=".07" pos=".3 -.4 0" rgba="0 0 1 1" material="red"/>
      <geom name="hull" type="sphere" size=".3" group="3" contype="0" conaffinity="0"/>
      <geom name="ghost" type="box" size=".3 .3 .3" rgba="1 0 1 .1" contype="0" conaffinity="0"/>
      <site name="mark" pos="0 0 .2" size=".01"/>
      <site name="face" pos="0 0 .2" size=".02" group="2" rgba="1 1 0 1"/>
    </body>
  </worldbody>
  <actuator><motor name="turn" joint="turn"/></actuator>
</mujoco>
"""


def things_file(folder: Path) -> str:
    """The model as a file in the folder; returns its path."""
    path = folder / "things.xml"
    path.write_text(THINGS)
    return str(path)
