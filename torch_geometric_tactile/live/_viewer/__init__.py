r"""Parts of the viewer: the page, its clients and messages, and the scene."""
