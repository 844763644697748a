"""When the stages give up on a demonstrator that fails too often."""

MAX_ATTEMPTS = 4  # attempts per demonstration before the stage gives up on an expert
# Minimum number of attempts before the stage gives up on an expert: one that succeeds in a quarter of the contexts
# fails 64 times in a row with a probability of 1e-8.
FEWEST_ATTEMPTS = 64
