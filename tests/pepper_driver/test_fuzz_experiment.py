"""Whatever is in an experiment file: it is planned, or one line says what is wrong; nothing was begun then."""

from typing import Any

import pytest
from experiment_cases import EXAMPLES, fake
from hypothesis import HealthCheck, given, settings

from pepper_driver.config import PepperError
from pepper_driver.config.loading import read_yaml
from pepper_driver.experiment import ExperimentRun

from yaml_cases import damaged, dump  # isort: skip


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_a_damaged_experiment_begins_nothing(
    example: Any, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    backend, _ = fake(monkeypatch)
    path = tmp_path_factory.mktemp("fuzz") / "mine.yaml"

    @settings(
        max_examples=40,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )
    @given(damaged(read_yaml(example)))
    def damage(data: Any) -> None:
        path.write_text(dump(data), encoding="utf-8")
        try:
            run = ExperimentRun(path)
        except PepperError as error:
            assert len(str(error).splitlines()) == 1
        else:
            assert 0.0 < run.experiment.length <= run.experiment.longest
        assert backend.calls == []

    damage()
