"""Handmade evaluations, and a browser to look at the page with."""

from __future__ import annotations

import base64
import json
import os
import select
import shutil
import subprocess

import numpy as np
import pytest

from artifacts import read_artifact, write_artifact

EPISODES = 4
SECONDS = 60  # that a browser on a busy machine may think
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--hide-scrollbars",
    "--mute-audio",
    "--remote-debugging-pipe",
    "--window-size=1100,900",
]


def made_by(method):
    """The options of learn-policy behind a method: `translation without img` or the name of a reward."""
    reward, _, without = method.partition(" without ")
    return {"reward": reward, **({"without": without.split(", ")} if without else {})}


@pytest.fixture
def evaluation(tmp_path):
    """A function that writes an evaluation whose runs leave given parts of the distance."""

    def write(
        name="reach",
        left=(0.1, 0.9),
        *,
        task="reach",
        methods=("translation",),
        curves=True,
        old=False,
        parents=(),
        folder=tmp_path,
        first_seed=0,
        threshold=0.5,
        deterministic=None,
        **fields,
    ):
        """`left`: normalised distances per run; `deterministic`: those of the deterministic policies, if others.

        `old`: as ifo wrote evaluations before it recorded methods.
        """
        count = len(left)
        noisy, calm = (
            np.repeat(np.array(values, float)[:, None], EPISODES, axis=1) for values in (left, deterministic or left)
        )
        arrays = {
            "initial_distance": np.full((count, EPISODES), 2.0),
            "final_distance": calm * 2,
            "normalised_distance": calm,
            "final_distance_stochastic": noisy * 2,
            "normalised_distance_stochastic": noisy,
        }
        if curves and not old:
            arrays["curve/samples"] = np.tile([100.0, 200.0, 300.0], (count, 1))
            arrays["curve/normalised_distance"] = np.linspace(np.ones(count), left, 3, axis=1)
        runs = []
        for k in range(count):
            method = methods[k % len(methods)]
            run = {
                "policy": f"{name}-c{k}.policy.h5",
                **made_by(method),
                "seed": first_seed,
                "context_seed": k,
                "translation_metrics": {"psnr": 30.5, "tau_expert": 0.75},
                "samples": 300,
                "learning_minutes": 1.5,
            }
            if not old:
                run |= {"method": method, "translator": {"steps": 9, "minutes": 20.0}, "own_context": False}
            runs.append({**run, **fields})
        config = {"task": task, "runs": runs, **({} if old else {"success_threshold": threshold})}
        return write_artifact(
            folder / f"{name}.evaluation.h5",
            "evaluation",
            arrays,
            config=config,
            seed=3,
            command=f"ifo evaluate {name}",
            parents=parents,
            environment={"python": "3"},
        )

    return write


@pytest.fixture
def runs_of():
    """A function that reads all runs of evaluations."""
    from stages.reporting.rows import read_runs

    return lambda *paths: [run for path in paths for run in read_runs(read_artifact(path, "evaluation"))]


class Browser:
    """Chromium without a window, spoken to through a pipe by its DevTools protocol."""

    def __init__(self, program, folder):
        reads, self._out = os.pipe()
        self._answers, writes = os.pipe()
        # The protocol's pipe is descriptors 3 and 4.
        script = f'exec "$@" 3<&{reads} 4>&{writes}'
        command = ["bash", "-c", script, "bash", program, *FLAGS, f"--user-data-dir={folder}"]
        self._process = subprocess.Popen(
            command, pass_fds=(reads, writes), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        os.close(reads)
        os.close(writes)
        self._asked, self._session, self._buffer = 0, None, b""
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def open(self, path):
        """Open a file as a user would, by its address."""
        self._ask("Page.enable")
        self._ask("Page.navigate", url=path.resolve().as_uri())

    def evaluate(self, script):
        """The value of an expression in the page, a promise's once it is kept."""
        answer = self._ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def screenshot(self, path):
        """Take a picture of the whole page."""
        answer = self._ask("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(answer["data"]))

    def close(self):
        self._process.kill()
        self._process.wait()
        os.close(self._answers)
        os.close(self._out)

    def _ask(self, method, **parameters):
        self._asked += 1
        message = {"id": self._asked, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = json.loads(self._next())
            if answer.get("id") == self._asked:
                assert "error" not in answer, answer
                return answer["result"]

    def _next(self):
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._answers], [], [], SECONDS)
            piece = os.read(self._answers, 1 << 16) if ready else b""
            assert piece, "Chromium ended, or says nothing"
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        return message


@pytest.fixture
def browser(tmp_path):
    program = shutil.which("chromium") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("no Chromium here; on Debian: apt-get install chromium")
    found = Browser(program, tmp_path / "profile")
    yield found
    found.close()
