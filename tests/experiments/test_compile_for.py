"""The command that compiles for a GPU: what is counted, and what is written."""

import importlib.util
import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import pytest

from dc2g_jax._src.runtime.devices import mesh_of
from dc2g_jax._src.runtime.errors import InputError
from experiments import compile_for
from experiments.benchmarks.hot_programs import hot_programs
from experiments.benchmarks.launches import Launches, count_launches
from experiments.compile_for import Cost, Options, Target, lowered, main, step_of
from tests.support.refusals import refusal

#: All programs, for few robots.
PROGRAMS = hot_programs(robots=4, driving=2)

HLO = """HloModule example

%row (all: f32[100,10], at: s32[]) -> f32[10] {
  %all = f32[100,10]{1,0} parameter(0)
  %at = s32[] parameter(1)
  %zero = s32[] constant(0)
  %cut = f32[1,10]{1,0} dynamic-slice(%all, %at, %zero), dynamic_slice_sizes={1,10}
  ROOT %flat = f32[10]{0} bitcast(%cut)
}

%write (all.1: f32[100,10], new: f32[1,10], at.1: s32[]) -> f32[100,10] {
  %all.1 = f32[100,10]{1,0} parameter(0)
  %new = f32[1,10]{1,0} parameter(1)
  %at.1 = s32[] parameter(2)
  %zero.1 = s32[] constant(0)
  ROOT %put = f32[100,10]{1,0} dynamic-update-slice(%all.1, %new, %at.1, %zero.1)
}

%body (state: (f32[100,10], s32[])) -> (f32[100,10], s32[]) {
  %state = (f32[100,10]{1,0}, s32[]) parameter(0)
  %a = f32[100,10]{1,0} get-tuple-element(%state), index=0
  %i = s32[] get-tuple-element(%state), index=1
  %fusion = f32[10]{0} fusion(%a, %i), kind=kLoop, calls=%row, metadata={op_name="a"}
  %wide = f32[1,10]{1,0} bitcast(%fusion)
  %fusion.1 = f32[100,10]{1,0} fusion(%a, %wide, %i), kind=kLoop, calls=%write
  ROOT %next = (f32[100,10]{1,0}, s32[]) tuple(%fusion.1, %i)
}

%condition (state.1: (f32[100,10], s32[])) -> pred[] {
  %state.1 = (f32[100,10]{1,0}, s32[]) parameter(0)
  %i.1 = s32[] get-tuple-element(%state.1), index=1
  ROOT %less = pred[] compare(%i.1, %i.1), direction=LT
}

ENTRY %main (a.1: f32[100,10], i.2: s32[]) -> f32[100,10] {
  %a.1 = f32[100,10]{1,0} parameter(0)
  %i.2 = s32[] parameter(1)
  %copy = f32[100,10]{1,0} copy(%a.1)
  %first = (f32[100,10]{1,0}, s32[]) tuple(%copy, %i.2)
  %while = (f32[100,10]{1,0}, s32[]) while(%first), condition=%condition, body=%bodyTURNS
  ROOT %result = f32[100,10]{1,0} get-tuple-element(%while), index=0
}
"""

#: A row read, with the index, and written; the same again; two indices compared.
A_TURN = Launches(3, (40 + 40 + 4) + (40 + 40 + 4) + (1 + 4 + 4))


def test_a_loop_of_unknown_length_stands_apart():
    assert count_launches(HLO.replace("TURNS", "")) == Launches(1, 8000, [A_TURN])


def test_a_loop_of_known_length_counts_with_all_its_turns():
    known = ', backend_config={"known_trip_count":{"n":"5"}}'
    assert count_launches(HLO.replace("TURNS", known)) == Launches(1 + 5 * 3, 8000 + 5 * A_TURN.bytes)


def test_loops_of_a_program_as_compiled_are_found():
    @jax.jit
    def halvings(x):
        return jax.lax.while_loop(lambda x: jnp.max(x) > 1, lambda x: jnp.sin(x) / 2, x)

    (loop,) = count_launches(halvings.lower(jnp.ones(1000)).compile().as_text()).loops
    assert loop.kernels >= 2
    assert loop.bytes >= 3 * 4000


def test_a_step_is_a_turn_of_the_loops_around_it():
    search, step = Launches(2, 20), Launches(5, 50)
    step.loops, short = [search], Launches(1, 10)
    program = Launches(9, 90, [Launches(3, 30, [short, step])])
    assert step_of(program, 2) == Launches(8, 80, [short, search])
    assert step_of(program, 0) == program


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_program_takes_its_arguments(name):
    count, make = PROGRAMS[name]
    hot = make(mesh_of(jax.devices()[:count]))
    assert len(hot.specs) == len(hot.arguments)
    lowered(hot)


def test_a_program_that_fails_does_not_stop_the_others(tmp_path, monkeypatch, capsys):
    names = ("drive step", "training gradient")

    def cost(name, hot, target):
        if name == "drive step":
            raise ValueError("too large\nfor this device")
        return Cost(name, 64, True, 3.2, 100.4, 12.0, 16, 2_000_000, ((3, 1_000_000),), 5e6, 0.9)

    monkeypatch.setattr(compile_for, "open_target", lambda name: Target((), 1.0, 1.0))
    monkeypatch.setattr(compile_for, "cost", cost)
    monkeypatch.setattr(compile_for, "hot_programs", lambda *_: dict.fromkeys(names, (0, len)))
    monkeypatch.setattr(compile_for, "mesh_of", lambda devices: devices)
    out = tmp_path / "out"
    main(Options(out=out))
    written = json.loads((out / "compiled.json").read_text())
    failed, other = written["programs"]
    assert (written["target"], failed["compiled"], failed["error"]) == ("h100", False, "ValueError: too large")
    assert (other["program"], other["compiled"], other["loops"]) == ("training gradient", True, [[3, 1_000_000]])
    printed = capsys.readouterr().out
    assert "| drive step | failed: ValueError: too large |" in printed
    assert "| training gradient | 64 | 3 | 100 | 12 | 16 | 2 | 5 | 1 | 3 (1 MB) |" in printed


def test_what_is_no_program_is_refused(tmp_path):
    wrong = Options(program=("rollout",), out=tmp_path / "out")
    refusal(lambda: main(wrong), "--program rollout", "rollout frontier", "sweep learn")


def test_the_extra_is_asked_for_where_it_is_missing(monkeypatch):
    def missing(**_):
        raise NotImplementedError("topology not implemented for cuda")

    monkeypatch.setattr(compile_for.topologies, "get_topology_desc", missing)
    with pytest.raises(InputError, match=r"not installed.*cuda-compile"):
        compile_for.open_target("h100")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("jax_cuda12_plugin") is None, reason="needs the extra cuda-compile")
def test_a_rollout_compiles_for_a_gpu_that_is_not_there(tmp_path):
    out = tmp_path / "out"
    words = ["h100", "--program", "rollout frontier", "--robots", "64", "--out", str(out)]
    subprocess.run([sys.executable, "-m", "experiments.compile_for", *words], check=True)
    (rollout,) = json.loads((out / "compiled.json").read_text())["programs"]
    assert rollout["compiled"]
    assert rollout["kernels_a_step"] > 10
    assert len(rollout["loops"]) == 2
    assert rollout["floor_us"] > 0
