"""Labels are sealed: whole, unchanged, and in one place."""

import pytest

from examination.blind.case_files import seal, unseal
from sma_bench.errors import InputError

LABELS = [{"id": "0001", "effects": ["latent_heat"], "severity": 2.5}]


def test_labels_come_back_when_the_digest_fits(tmp_path):
    sha256 = seal(tmp_path / "labels.sealed", LABELS)
    assert unseal(tmp_path / "labels.sealed", sha256) == LABELS
    assert unseal(tmp_path / "labels.sealed") == LABELS


def test_sealed_file_does_not_show_a_label_to_the_eye(tmp_path):
    seal(tmp_path / "labels.sealed", LABELS)
    assert b"latent" not in (tmp_path / "labels.sealed").read_bytes()


@pytest.mark.parametrize("damage", ["other labels", "cut", "text", "gone"])
def test_broken_seal_is_one_line(tmp_path, damage):
    path = tmp_path / "labels.sealed"
    sha256 = seal(path, LABELS)
    content = path.read_bytes()
    if damage == "other labels":
        seal(path, [])
        with pytest.raises(InputError, match="sha256 differs"):
            unseal(path, sha256)
        return
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes(content[:-9] if damage == "cut" else b"[]")
    with pytest.raises(InputError, match="cannot read|damaged") as error:
        unseal(path)
    assert "\n" not in str(error.value)
