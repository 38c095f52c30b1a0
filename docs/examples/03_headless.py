"""Render without a screen: an image, a segmentation and the depth of each pixel."""

import numpy as np
from PIL import Image
from sero_mj import HeadlessRenderer, Placer, Scene, SerialRobot, World

world = World(Scene(robots=[SerialRobot.from_model("fr3", show_arrows=True)]))
data = world.make_data()
world.set_input(data, "fr3.joint_angles", [0.3, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8])
world.set_input(data, "fr3.torques", [5.0, -40.0, 3.0, 20.0, 0.0, -2.0, 0.5])
Placer(world).place(data)

with HeadlessRenderer(world, 320, 400, camera="140,-15,2.2") as renderer:
    image = renderer.render(data)  # (400, 320, 3), uint8
    parts = renderer.segmentation(data)  # (400, 320), int32: the link in each pixel
    depth = renderer.depth(data)  # (400, 320), float32, m
    names = renderer.part_names

for number in np.unique(parts):
    seen = parts == number
    print(
        f"{names[number]:12} {seen.sum():6} pixels, nearest {depth[seen].min():.2f} m"
    )

colors = np.random.default_rng(3).integers(40, 255, (len(names), 3), dtype=np.uint8)
Image.fromarray(np.hstack([image, colors[parts]])).save("03_headless.webp")
