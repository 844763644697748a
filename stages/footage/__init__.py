"""Real footage: finding videos, reading them frame by frame, and selecting a crop and a time segment."""
