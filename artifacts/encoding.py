"""Encoding of videos for inspection. This is a separate module without imports, so that help texts can use it."""

CRF = 12  # x264's constant rate factor: hard to distinguish from the original
