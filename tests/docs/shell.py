"""Commands of the tutorials, as they stand, on Pythons that have imported torch already.

``make`` finds a finished installation whose ``python`` hands what it is asked to a server: one
process that has imported what every command imports, and forks for each. The commands' own code
runs as it would, in a process of its own, with its arguments, folder and environment.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
KEPT_OUT = ("TRUST", "MAKEFLAGS", "MAKELEVEL", "MFLAGS")
SERVER = """
import json, os, runpy, socket, sys, traceback
import matplotlib, pandas, plotly, jinja2
import pipeline.build, pipeline.commands.evaluate_run, pipeline.cli, configs

listening = socket.socket(socket.AF_UNIX)
listening.bind(sys.argv[1])
listening.listen()
print("ready", flush=True)
while True:
    asking, _ = listening.accept()
    request, streams, _, _ = socket.recv_fds(asking, 1 << 20, 2)
    told = json.loads(request)
    child = os.fork()
    if child == 0:
        for number, stream in zip((1, 2), streams):
            os.dup2(stream, number)
        os.chdir(told["folder"])
        os.environ.clear()
        os.environ.update(told["environment"])
        sys.argv = ["-m", *told["arguments"][1:]]
        code = 0
        try:
            runpy.run_module(told["arguments"][0], run_name="__main__", alter_sys=True)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
            if isinstance(end.code, str):
                print(end.code, file=sys.stderr)
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    for stream in streams:
        os.close(stream)
    asking.send(bytes([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) % 256]))
    asking.close()
"""
CLIENT = """
import json, os, socket, sys

arguments = [a for a in sys.argv[2:] if a != "-u"]
if arguments[:1] != ["-m"]:
    sys.exit(f"the server runs modules, not {arguments}")
asking = socket.socket(socket.AF_UNIX)
asking.connect(sys.argv[1])
told = {"arguments": arguments[1:], "folder": os.getcwd(), "environment": dict(os.environ)}
socket.send_fds(asking, [json.dumps(told).encode()], [1, 2])
sys.exit(asking.recv(1)[0])
"""


class Shell:
    """Runs command lines that call ``make``; to be closed.

    Args:
        folder: Of the installation that make finds, and of the socket.
    """

    def __init__(self, folder: Path) -> None:
        socket = folder / "socket"
        (folder / "client.py").write_text(CLIENT)
        (folder / "venv" / "bin").mkdir(parents=True)
        python = folder / "venv" / "bin" / "python"
        asks = f'"{sys.executable}" -I -S "{folder / "client.py"}" "{socket}"'
        python.write_text(f'#!/bin/sh\nexec {asks} "$@"\n')
        python.chmod(0o755)
        (folder / "venv" / ".installed-").touch()
        self.venv = folder / "venv"
        self.server = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", SERVER, str(socket)],
            cwd=ROOT,
            env=self._kept() | {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.server.stdout is not None
        assert self.server.stdout.readline() == "ready\n", "the server did not start"

    def run(self, commands: str, folder: Path, **environment: str) -> str:
        """What the commands print; fails with all of it if one of them does."""
        given = {
            "VENV": str(self.venv),
            "EXTRAS": "",
            "OMP_NUM_THREADS": "1",
            "PWD": str(folder),
        } | environment
        done = subprocess.run(
            ["sh", "-c", f"set -eu\n{commands}"],
            cwd=folder,
            env=self._kept() | given,
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, f"{commands}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    def close(self) -> None:
        """Ends the server."""
        self.server.terminate()
        self.server.communicate()

    @staticmethod
    def _kept() -> dict[str, str]:
        return {key: value for key, value in os.environ.items() if key not in KEPT_OUT}
