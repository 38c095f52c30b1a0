"""Export a run as one HTML file that plays in a browser, offline."""

from pathlib import Path

import sero_mj

scene = sero_mj.load_scene("impedance_push")
sero_mj.export_html(scene, "push.html", title="A push", seconds=5.0, fps=30)
print(
    f"push.html: {Path('push.html').stat().st_size / 1e6:.1f} MB; open it in a browser"
)

# The same view as an image
sero_mj.render_image(
    scene, "06_page.webp", at=1.6, size=(640, 400), camera="120,-20,2.6"
)
