"""Networks: the shipped ones, and what a file of one's own may say."""

from pathlib import Path

import pytest

from pepper_driver.config import ConfigError, UnknownNameError, load_network, network_names
from pepper_driver.config.loading import package_file


def test_the_shipped_networks_load_under_their_own_names() -> None:
    assert set(network_names()) == {"clear", "wired", "wifi"}
    for name in network_names():
        assert load_network(name).name == name


def test_an_unknown_network_names_the_close_one() -> None:
    with pytest.raises(UnknownNameError, match="did you mean wifi"):
        load_network("wi-fi")


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ("delay: 0.0015", "delay: -0.001", "delay"),
        ("stall_probability: 0.003", "stall_probability: 3", "stall_probability"),
        ("stall: 0.06", "stall: .nan", "nan"),
        ("jitter: 0.001", "jiter: 0.001", "did you mean jitter"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, old: str, new: str, word: str) -> None:
    text = package_file("networks", "wifi.yaml").read_text()
    assert f"\n{old}" in text
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace(f"\n{old}", f"\n{new}"))
    with pytest.raises(ConfigError, match=f"(?i){word}"):
        load_network(str(path))
