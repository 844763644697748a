"""Datasets of other libraries: reading their episodes as footage, and writing demonstrations in their formats."""
