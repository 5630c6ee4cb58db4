"""The table of IMUs in the documentation matches the files."""

from pathlib import Path

from imucalib_cli.signals.imu.data_sheet import ImuModel, imu_names, load_imu_model

PAGE = Path(__file__).parents[2] / "docs" / "simulation.md"
HEAD = (
    "| `--imu-model` | what it is | noise µg/√Hz | noise °/s/√Hz | in-run µg | in-run °/h | "
    "bias mg | bias °/s | up to g | up to °/s | figures from |\n"
    "|---|---|---|---|---|---|---|---|---|---|---|"
)
KIND = {"typical": "", "1 sigma": " σ", "max": " max"}


def row(model: ImuModel) -> str:
    def figure(value: float | None, kind: str = "") -> str:
        return "-" if value is None else f"{value:g}{kind}"

    source = model.sources[0]
    cells = (
        f"[`{model.name}`](../configs/imus/{model.name}.yaml)",
        f"{model.maker} {model.title}",
        figure(model.accel_noise_ug),
        figure(model.gyro_noise_deg),
        figure(model.accel_bias_instability_ug),
        figure(model.gyro_bias_instability_deg_h),
        figure(model.accel_bias_mg, KIND[model.accel_bias_kind]),
        figure(model.gyro_bias_deg, KIND[model.gyro_bias_kind]),
        figure(max(model.accel_range_g)),
        figure(max(model.gyro_range_deg)),
        f"[{source.document}]({source.url})",
    )
    return f"| {' | '.join(cells)} |"


def table() -> str:
    """What belongs in the page; to renew it print this."""
    return "\n".join([HEAD, *(row(load_imu_model(name)) for name in imu_names())])


def test_documented_imus_match_the_files() -> None:
    assert table() in PAGE.read_text(encoding="utf-8")
