"""Real footage: finding videos, reading them frame by frame, and what part of their picture and time is taken."""
