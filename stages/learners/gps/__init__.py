"""The trajectory-centric learner of guided policy search (Levine and Abbeel 2014; Levine et al. 2016), one context."""
