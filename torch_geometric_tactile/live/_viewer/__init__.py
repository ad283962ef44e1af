r"""What the viewer is made of: scene, screen, clients and their messages."""
