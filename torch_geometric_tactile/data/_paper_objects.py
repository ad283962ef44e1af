r"""Properties of the objects of the "Tactile Object Property Recognition ..." paper, for the data
set and the simulator.
"""

#: The properties of objects, in the order of the "Tactile Object Property Recognition ..." paper.
PROPERTIES = ("light", "heavy", "hard", "soft", "non-slippery", "slippery")

#: The properties of the eight objects in that paper by name, in the order of the paper.
PAPER_OBJECTS = {
    "plastic_tube": ("light", "soft", "slippery"),
    "sponge": ("light", "soft", "non-slippery"),
    "mayonnaise": ("heavy", "soft", "slippery"),
    "kitchen_paper": ("heavy", "soft", "non-slippery"),
    "potato_chip_can": ("light", "hard", "slippery"),
    "mango_replica": ("light", "hard", "non-slippery"),
    "saran_wrap": ("heavy", "hard", "slippery"),
    "purse": ("heavy", "hard", "non-slippery"),
}
