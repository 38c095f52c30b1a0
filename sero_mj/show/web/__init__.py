"""The web page: MuJoCo Studio's `WebViewer` with our plugins."""
