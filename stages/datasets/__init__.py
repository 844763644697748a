"""Data sets of other libraries: their episodes as footage, and demonstrations written as such data sets."""
