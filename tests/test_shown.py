"""Names as people read and sort them."""

from imucalib_cli.shown import natural_key


def test_numbers_in_names_count_as_numbers() -> None:
    names = ["day10", "day2", "day1", "²", "7", "day1.5", "a", ""]
    assert sorted(names, key=natural_key) == ["", "7", "a", "day1", "day1.5", "day2", "day10", "²"]
