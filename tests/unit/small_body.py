"""A small MuJoCo body for tests: an arm of two hinges with a motor each, sensors and an eye."""

import mujoco

ARM = """
<mujoco model="arm">
  <option timestep="0.005"/>
  <size nuser_actuator="3"/>
  <worldbody>
    <light pos="0 0 2"/>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" range="-90 60" limited="true" damping="0.2" stiffness="0.1"/>
      <geom name="upper" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.03" mass="0.3"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow" axis="0 1 0" range="-120 0" limited="true" damping="0.1" springref="-30"/>
        <geom name="lower" type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/>
        <site name="tip" pos="0 0 -0.2"/>
        <camera name="eye" pos="0 0 -0.2" fovy="60"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="lift" joint="shoulder" gear="2" ctrlrange="-1 1" ctrllimited="true"
           forcerange="-0.5 1" forcelimited="true" user="1.5 4 8"/>
    <motor name="bend" joint="elbow" gear="1" ctrlrange="-2 4" ctrllimited="true" user="1.5 4 8"/>
  </actuator>
  <sensor>
    <accelerometer name="acceleration" site="tip"/>
    <gyro name="rotation" site="tip"/>
  </sensor>
  <keyframe>
    <key name="bent" qpos="0.5 -1.5"/>
  </keyframe>
</mujoco>
"""


def arm() -> mujoco.MjModel:
    """The arm, compiled anew."""
    return mujoco.MjModel.from_xml_string(ARM)
