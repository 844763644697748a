"""What a learner lives in, behind one protocol: the batched simulation, or any Gymnasium environment."""
