"""The web page: MuJoCo Studio's `WebViewer` with plugins of sero-mj."""
