"""sim.toml: what it says is what arrives, and what is wrong is refused before anything is computed."""

import os
import subprocess
import sys

import pytest
from helpers import SIMULATION

from hpcred.parallel.failures import InputError
from hpcred.settings.simulation_file import read_simulation
from hpcred.simulation import Bushing, Joint, LineSpring, RampDrive, SineForce, SineMoment, TableForce


@pytest.fixture
def path(tmp_path):
    (tmp_path / "sim.toml").write_text(SIMULATION)
    return tmp_path / "sim.toml"


def test_settings_arrive(path):
    setup = read_simulation(path, ["velocity=[0.0, 0.0, 1.0]", "force.0.frequency=7.0"])
    assert setup.body == str(path.parent / "result.h5") and setup.output == str(path.parent / "simulation.h5")
    assert setup.velocity == (0.0, 0.0, 1.0) and setup.end == 0.05 and setup.nodes == [1, 7, 10, 14, 20]
    assert setup.force[0] == SineForce(20, (0.0, 0.0, -10.0), 7.0) and isinstance(setup.force[1], TableForce)
    assert setup.constraint == (Joint(1), Joint(7, ("x", "z")), Joint(14, ("z",)))


def test_joints_and_names_arrive(tmp_path):
    (tmp_path / "sim.toml").write_text("""
body = "result.h5"
end = 1.0
observe = ["tip", 3]
moment = [{kind = "sine", node = "tip", amplitude = [1.0, 0.0, 0.0], frequency = 2.0, axes = "body"}]
[[constraint]]
node = "hub"
kind = "revolute"
axis = [0.0, 1.0, 0.0]
[[constraint]]
node = 4
kind = "universal"
axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
[[drive]]
kind = "ramp"
node = "hub"
about = [0.0, 1.0, 0.0]
rate = 3.0
[[spring]]
kind = "line"
node = 5
at = [0.0, 0.0, 0.0]
stiffness = 2.0
[[spring]]
kind = "bushing"
node = "tip"
rotational_damping = [1.0, 2.0, 3.0]
""")
    setup = read_simulation(tmp_path / "sim.toml")
    assert setup.nodes == [3, 4, 5, "hub", "tip"]
    assert setup.moment == (SineMoment("tip", (1.0, 0.0, 0.0), 2.0, axes="body"),)
    assert setup.constraint == (
        Joint("hub", kind="revolute", axis=(0.0, 1.0, 0.0)),
        Joint(4, kind="universal", axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
    )
    assert setup.drive == (RampDrive(node="hub", about=(0.0, 1.0, 0.0), rate=3.0),)
    assert setup.spring == (
        LineSpring(5, (0.0, 0.0, 0.0), 2.0), Bushing("tip", rotational_damping=(1.0, 2.0, 3.0))
    )  # fmt: skip


@pytest.mark.parametrize(
    "change, says",
    [
        ("ende=1.0", r"ende: unknown key \(did you mean 'end'\?\)"),
        ("end=-1.0", "end: found -1, expected a finite number of more than 0"),
        ("end=soon", "end: found 'soon', expected a number"),
        ("start=rest", "start: found 'rest', expected 'given' or 'static'"),
        ("force.0.kind=cosine", r"force\[0\].kind: found 'cosine', expected one of constant, sine, table"),
        ("force.0.freq=2.0", r"force\[0\].freq: unknown key .*; known are kind, node, axes, amplitude"),
        ("force.0.frequency=0.0", "force.frequency: found 0, expected a number of more than 0"),
        ("force.1.times=[0.0]", "force.values: found 2 values for 1 times"),
        ("force.1.times=[1.0, 0.0]", "force.times: found 0 s after 1 s, expected ascending times"),
        ("force.1.times=[]", "force.times: found an empty list"),
        ("steps=500000000", r"steps: found 5e\+08, expected 1 to 1e\+07"),
        ("velocity=[0.0, 1e12, 0.0]", "velocity: found 1e\\+12, expected .* m/s"),
        ("spring={node=1}", r"spring: found a single table, expected a list .* write \[\[spring\]\] in place of"),
        ("constraint.1.directions=['x', 'q']", r"constraint.directions: found \['x', 'q'\]"),
        ("constraint.1.kind='hinge'", r"constraint\[1\].kind: found 'hinge', expected 'point' or 'spherical'"),
        ("constraint.1.kind='fixed'", "constraint.directions: found .* at a joint of kind 'fixed'"),
        ("constraint.0.axis=[0.0, 1.0]", r"constraint\[0\].axis: found \[0.0, 1.0\], expected \[a number,"),
        ("constraint.0.axes=[[0.0, 1.0, 0.0]]", r"constraint\[0\].axes: found \[\[0.0, 1.0, 0.0\]\]"),
        ("force.0.node=1.5", r"force\[0\].node: found 1.5, expected a whole number or a text"),
        ("force.0.axes='node'", r"force\[0\].axes: found 'node', expected 'inertial' or 'body'"),
        ("spring=[{node=1}]", r"spring\[0\].kind: missing; expected one of line, bushing"),
        ("drive=[{kind='ramp', node=1, rate=1.0}]", "drive: node 1 needs a direction `along`"),
        ("drive=[{kind='ramp', node=1, along=[1.0, 0.0, 0.0]}]", r"drive\[0\].rate: missing; expected a number"),
        ("gravity=[0.0, 1.0]", r"gravity: found \[0.0, 1.0\], expected \[a number, a number, a number\]"),
        ("gravity=[0.0, 0.0, nan]", r"gravity: found \[0.0, 0.0, nan\], expected .* finite"),
        ("force.0.amplitude=[0.0, 0.0, inf]", r"force\[0\].amplitude: found .* finite"),
        ("end=inf", "end: found inf, expected a number that is finite"),
        ("output=result.h5", "which is the body; choose another name"),
        ("output=motion.csv", "expected an HDF5 file such as simulation.h5"),
    ],
)  # fmt: skip
def test_settings_are_refused(path, change, says):
    with pytest.raises(InputError, match=says):
        read_simulation(path, [change])


def test_names_that_the_locale_has_no_letters_for_are_refused(path):
    """Python takes UTF-8 for names of files in the locale C, but where it is told not to, and in no other locale."""
    text = path.read_text().replace('body = "', 'body = "ü')
    path.write_text(text, encoding="utf-8")
    code = f"from hpcred.settings.simulation_file import read_simulation; read_simulation({str(path)!r})"
    narrow = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    done = subprocess.run([sys.executable, "-c", code], env=narrow, capture_output=True, text=True)
    assert r"InputError" in done.stderr and r"body: found '\xfcresult.h5', with letters that" in done.stderr
    read_simulation(path)


def test_a_job_of_another_command_is_named(tmp_path):
    for text, says in (('model = "m.h5"\nband = [0.0, 1.0]\n', "found a job, which `hpcred reduce` reads"),
                       ('job = "job.toml"\n', "found a sweep, which `hpcred sweep` reads")):  # fmt: skip
        (tmp_path / "other.toml").write_text(text)
        with pytest.raises(InputError, match=says):
            read_simulation(tmp_path / "other.toml")
