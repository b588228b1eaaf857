"""NAOqi's library and pinocchio in one process: in the wrong order they crash it."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.usefixtures("qi")

LOSS = """
import subprocess, sys
from pepper_driver import Pepper
from pepper_driver.backends.naoqi.qi_library import load_qi
assert list(sys.modules).index("qi") < list(sys.modules).index("pinocchio")
SERVER = '''
import sys, time
from pepper_driver.backends.naoqi.qi_library import load_qi
class Slow:
    def echo(self, value): time.sleep(0.001); return value
session = load_qi().Session()
session.listenStandalone("tcp://127.0.0.1:0")
session.registerService("Slow", Slow())
print(session.endpoints()[-1], flush=True)
sys.stdin.read()
'''
for _ in range(3):
    pipe = subprocess.PIPE
    server = subprocess.Popen([sys.executable, "-c", SERVER], stdin=pipe, stdout=pipe, text=True)
    session = load_qi().Session()
    session.connect(server.stdout.readline().strip())
    slow = session.service("Slow")
    calls = [slow.echo([1.0] * 60, _async=True) for _ in range(5)]
    server.kill()
    try:
        calls += [slow.echo(1, _async=True) for _ in range(5)]
    except RuntimeError:
        pass
    for call in calls:
        call.wait(1000)
    session.close()
    server.wait()
print("well")
"""


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)


def test_a_lost_connection_does_not_crash_the_process() -> None:
    """With pinocchio first this ends in a segmentation fault each time."""
    done = run(LOSS)
    assert done.returncode == 0, done.stderr[:2000]
    assert done.stdout.strip() == "well"


def test_a_program_that_imports_pinocchio_first_is_warned() -> None:
    done = run(
        "import pinocchio\nfrom pepper_driver import Pepper\n"
        "from pepper_driver.backends.naoqi.qi_library import load_qi\nload_qi()"
    )
    assert "ImportOrderError: pinocchio was imported before" in done.stderr
