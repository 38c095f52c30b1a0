"""Draw on your own MuJoCo model: torques of its drives, and a target."""

import sero_mj  # before mujoco: selects an OpenGL backend that works without a display

import mujoco

MODEL = """
<mujoco model="arm">
  <compiler autolimits="true"/>
  <default><geom type="capsule" size="0.04"/><joint axis="0 1 0" damping="4"/></default>
  <worldbody>
    <body name="arm" pos="0 0 0.1">
      <joint name="base" axis="0 0 1"/><geom fromto="0 0 0 0 0 0.3" size="0.06"/>
      <body name="upper" pos="0 0 0.3"><joint name="shoulder"/>
        <geom fromto="0 0 0 0 0 0.4"/>
        <body name="lower" pos="0 0 0.4"><joint name="elbow"/>
          <geom fromto="0 0 0 0 0 0.35"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="base" kp="300" forcerange="-40 40"/>
    <position joint="shoulder" kp="300" forcerange="-80 80"/>
    <position joint="elbow" kp="300" forcerange="-40 40"/>
  </actuator>
</mujoco>"""
model = mujoco.MjModel.from_xml_string(MODEL)
data = mujoco.MjData(model)
overlay = sero_mj.overlay(
    model, data, doubles=[sero_mj.Double(name="target", of="arm")]
)
overlay.set("target.joint_angles", [0.0, 0.9, 1.0])
data.ctrl = [0.0, 0.9, 1.0]
for _ in range(1000):
    mujoco.mj_step(model, data)  # your own loop
print(overlay.robots, data.qfrc_actuator.round(1), "Nm")
overlay.image(640, 400).save("05_overlay.webp")
