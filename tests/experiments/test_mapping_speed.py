import json

from experiments import mapping_speed


def test_writes_a_row_for_each_case(tmp_path, monkeypatch, capsys):
    cases = (mapping_speed.Case(1, (6, 8), 10), mapping_speed.Case(3, (6, 8), 10))
    monkeypatch.setattr(mapping_speed, "CASES", cases)
    out = tmp_path / "out"
    mapping_speed.main(mapping_speed.Options(repeats=2, out=out))
    facts = json.loads((out / "mapping_speed.json").read_text())
    assert [(row["robots"], tuple(row["image"]), row["cells"]) for row in facts["rows"]] == list(cases)
    for row in facts["rows"]:
        assert 0 < row["integrate"] <= row["worst"]
        assert row["frames_a_second"] > 0
    assert capsys.readouterr().out.count("8x  6") == 2
