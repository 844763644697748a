"""How videos for people are encoded. A module of its own, without imports, so that help texts can name it."""

CRF = 12  # x264's constant rate factor: hard to tell from the original
