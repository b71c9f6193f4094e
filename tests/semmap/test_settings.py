"""Settings files: unknown keys fail, and what is written reads back the same."""

import pytest

from semmap.errors import SettingsError
from semmap.settings import Settings, load_yaml


class Inner(Settings):
    radius: float = 12.0
    sectors: int = 180


class Outer(Settings):
    contour: Inner = Inner()
    maybe: Inner | None = None
    name: str = "x"


def test_defaults_and_nested_values(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("contour: {radius: 8}\nmaybe: {sectors: 90}\n")
    settings = Outer.from_yaml(path)
    assert settings == Outer(contour=Inner(radius=8.0), maybe=Inner(sectors=90))


def test_written_settings_hold_every_value_and_read_back_the_same(tmp_path):
    settings = Outer(contour=Inner(radius=7.5))
    path = tmp_path / "s.yaml"
    path.write_text(settings.to_yaml())
    assert Outer.from_yaml(path) == settings
    assert "sectors: 180" in settings.to_yaml()


def test_an_empty_file_means_the_defaults(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text("")
    assert Outer.from_yaml(path) == Outer()


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("contour: {radus: 8}", r"contour\.radus: unknown key; did you mean `radius`"),
        ("maybe: {sector: 8}", r"maybe\.sector: unknown key; did you mean `sectors`"),
        ("zzz: 8", r"zzz: unknown key; known keys: contour, maybe, name"),
        ("contour: {sectors: many}", r"contour\.sectors: .*it holds 'many'"),
        ("5: 8", r"5: Keys should be strings"),
        ("a: b: c", r"line 1: mapping values are not allowed"),
        ("\0", "is not valid YAML"),
    ],
)
def test_bad_settings(text, pattern, tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=pattern) as caught:
        Outer.from_yaml(path)
    assert "\n" not in str(caught.value)


def test_text_that_is_not_utf8(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"a: \xff\xfe")
    with pytest.raises(SettingsError, match="cannot be read"):
        load_yaml(path, SettingsError)


def test_settings_cannot_be_changed():
    with pytest.raises(ValueError, match="frozen"):
        Outer().name = "y"
