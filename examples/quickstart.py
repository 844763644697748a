"""The whole pipeline in Python, on the simulated task reach: `python examples/quickstart.py` (about 15 minutes).

`python examples/quickstart.py --preset toy` takes less than a minute; nothing is learned then.
"""

import argparse

import ifo

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--preset", default="quick", choices=("toy", "quick", "paper"))
preset = parser.parse_args().preset

# Videos of the task, each in a different context, and a network that translates them between contexts.
demos = ifo.collect_demos("reach", preset=preset)
print("demonstrations:", demos.path)
translator = ifo.train_translator(demos, workers=2)
print(f"translator: {translator.summary['psnr']:.1f} dB PSNR, {translator.summary['copy_psnr']:.1f} dB by copying")

# The videos as they would look in the learner's context, which no video shows, and a policy that tracks them.
translation = ifo.translate(translator, context_seed=3)
policy = ifo.learn_policy(translation)
evaluation = ifo.evaluate(policy)
print(f"normalized final distance: {evaluation.summary['normalised_distance_stochastic']:.2f}")

target = ifo.read_artifact(translation, "translation")["target_images"]
print("the target (T, H, W, 3):", target.shape, "- to look at:", translation.path.with_suffix(".mp4"))
