"""A window on the screen: GLFW and MuJoCo's classic renderer."""
