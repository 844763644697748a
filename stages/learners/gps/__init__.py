"""Guided policy search's trajectory-centric learner (Levine and Abbeel 2014; Levine et al. 2016), one context."""
