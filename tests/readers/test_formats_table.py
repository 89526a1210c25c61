"""Every real log is read with the right axes, units and rate, or refused with a precise message."""

import math
from dataclasses import dataclass, field
from typing import Any

import pytest

from imucal.errors import ImucalError
from imucal.readers import read
from imucal.units import G0
from tests.real_data import real_data

GYRO = ("gyro_x", "gyro_y", "gyro_z")
ACCEL = ("accel_x", "accel_y", "accel_z")
BOTH = GYRO + ACCEL

#: Scales of an MPU-6050 with ranges 250 deg/s and 2 g.
MPU = {"gyro_scale": math.radians(1 / 131), "accel_scale": G0 / 16384}


@dataclass(frozen=True, kw_only=True)
class Known:
    """A log and its known properties.

    Attributes
    ----------
    files
        Path of the log, or paths of several files that form one log.
    options
        Options that the user must add.
    axes, n, rate
        Axes, number of samples and rate of the log.
    within
        Relative tolerance of the rate.
    first
        First samples of gyroscope x and accelerometer x in the unit of the file, and SI per unit.
    message
        Parts of the error message.
    """

    files: tuple[str, ...]
    options: dict[str, Any] = field(default_factory=dict)
    axes: tuple[str, ...] = BOTH
    n: int = 0
    rate: float = 0.0
    within: float = 5e-3
    first: tuple[tuple[float, float], ...] = ()
    message: tuple[str, ...] = ()

    def __str__(self) -> str:
        given = " with " + "+".join(self.options) if self.options else ""
        return "+".join(file.rpartition("/")[2] for file in self.files) + given


DEG = math.radians(1)

READ = (
    Known(
        files=("formats/euroc_kimera_micro_imu0_data.csv",),
        n=29120,
        rate=200,
        first=((-0.0020943951023931952, 1), (9.0874956666666655, 1)),
    ),
    Known(
        files=("formats/rostopic_echo_p_imu.csv",),
        n=2635,
        rate=400,
        first=((1.19800998937e-07, 1), (-0.000245457587107, 1)),
    ),
    Known(
        files=("formats/scikit_kinematics_xsens.txt",),
        n=3511,
        rate=120,
        first=((-0.011651, 1), (-9.404340, 1)),
    ),
    Known(
        files=("formats/synthetic_toolkit_static_temp.csv",),
        n=6000,
        rate=100,
        first=((0.008365660495705318, 1), (0.020634746742950287, 1)),
    ),
    # Stamps count ticks of 2.52 ms: 99.2 Hz by their median step, 100 Hz by their mean.
    Known(
        files=("formats/xio_fusion_sensor_data.csv",),
        n=13514,
        rate=100,
        first=((0.01644619, DEG), (0.001015204, G0)),
    ),
    Known(
        files=("formats/scikit_kinematics_xio_33.csv",),
        options={"rate_hz": 256.0},
        n=12626,
        rate=256,
        first=((2.1875, DEG), (-0.009277344, G0)),
    ),
    Known(
        files=("formats/madlab_imucal_ferraris_session.csv",),
        options={"rate_hz": 204.8},
        n=10376,
        rate=204.8,
        first=((-0.6103515625, DEG), (10.332114257812501, 1)),
    ),
    Known(
        files=("formats/st_unico_datalog.txt",),
        options={"rate_hz": 26.0},
        n=6000,
        rate=26,
        first=((157.5, 1e-3 * DEG), (-0.005429, G0)),
    ),
    Known(
        files=("formats/px4_ecl_replay_iris_gps.csv",),
        options={"columns": "t=0,g=5:8@imu,a=2:5@imu"},
        n=7062,
        rate=250,
        first=((-0.004373984, 1), (-0.19039628, 1)),
    ),
    Known(
        files=("formats/invariant_ekf_tagged.txt",),
        options={"columns": "t=1,g=2:5@IMU,a=5:8@IMU", "gyro_unit": "rad/s", "accel_unit": "m/s^2"},
        # The sensor's 800 Hz: the log repeats its samples at 2000 Hz.
        n=7997,
        rate=800,
        first=((0.018803, 1), (-1.887827, 1)),
    ),
    Known(
        files=(
            "formats/gnss_ins_sim_gyro_deg.csv",
            "formats/gnss_ins_sim_accel.csv",
        ),
        options={"rate_hz": 100.0},
        n=1000,
        rate=100,
        first=((-1.655572222222310985e-03, DEG), (-1.197099999999999970e-01, 1)),
    ),
    Known(
        files=("formats/gnss_ins_sim_gyro_deg.csv",),
        options={"rate_hz": 100.0},
        axes=GYRO,
        n=1000,
        rate=100,
        first=((-1.655572222222310985e-03, DEG),),
    ),
    Known(
        files=("formats/mcap_test_ulog.ulg",),
        n=1297,
        rate=199.7,
        first=((-0.12973590195178986, 1), (1.8269859552383423, 1)),
    ),
    Known(
        files=("formats/pyulog_sample.ulg",),
        n=17070,
        rate=248.5,
        first=((-0.001924943644553423, 1), (1.1071417331695557, 1)),
    ),
    Known(
        files=("formats/pyulog_sample_px4_events.ulg",),
        n=7783,
        rate=250,
        first=((-0.003195796627551317, 1), (0.06176302954554558, 1)),
    ),
    # Steps are 4.888 ms; 0.16 s are missing after the first sample.
    Known(
        files=("formats/pyulog_sample_log_small.ulg",),
        n=1298,
        rate=204.6,
        first=((0.002968383487313986, 1), (0.0012458056444302201, 1)),
    ),
    Known(files=("formats/robot_localization_test1_husky.bag",), n=11865, rate=30),
    Known(files=("formats/robot_localization_test2_jackal.bag",), n=3061, rate=50),
    # The computer stamped ten messages on arrival, so no rate can be right.
    Known(files=("formats/novatel_ins1.bag",), n=10, rate=1500, within=0.02, options={"topic": "/gps/imu"}),
    Known(
        files=("real/broad_rest/03_undisturbed_slow_rotation_C_rest.csv",),
        n=13057,
        rate=285.714,
        first=((0.00745779189, 1), (0.0194617002, 1)),
    ),
    Known(
        files=("real/stampfly/stampfly_fft_20260114T115628.csv",),
        n=12000,
        rate=399.9,
        first=((-0.00791773572564125, 1), (-0.3362545073032379, 1)),
    ),
    # Two of three rows repeat their predecessor, in bursts of up to 22 ms that may hide gaps.
    Known(
        files=("real/stampfly/stampfly_fft_20260113T222234.csv",),
        n=14992,
        rate=500,
        within=0.02,
        first=((-0.0015481454320251942, 1), (-0.15931354463100433, 1)),
    ),
    Known(
        files=("real/iphone_handheld/25.csv",),
        n=3065,
        rate=99.55,
        first=((0.07636747509241104, 1), (0.001617431640625, G0)),
    ),
    *(
        Known(
            files=(f"real/mpu6050/{name}.csv",),
            options=MPU,
            n=n,
            rate=100,
            first=((gyro, MPU["gyro_scale"]), (accel, MPU["accel_scale"])),
        )
        for name, n, gyro, accel in (
            ("example_data_tinit_calc", 44930, -429, 2508),
            ("imu_static_test", 9986, -480, 748),
            ("example_data_calibration", 10245, -447, -12),
            ("imu_90_x_rot", 9987, -449, 1116),
        )
    ),
    *(
        Known(
            files=(f"real/mpu6050/same_samples_every_format/{name}",),
            n=n,
            rate=100,
            first=((-0.0571562022, 1), (1.50116444, 1)),
        )
        for name, n in (
            ("imu_si.csv", 44930),
            ("imu_lz4.bag", 44930),
            ("imu_bz2.bag", 44930),
            ("ros2_mcap", 44930),
            ("ros2_mcap/ros2_mcap.mcap", 44930),
            ("ros2_sqlite3", 20000),
            ("ros2_sqlite3/ros2_sqlite3.db3", 20000),
        )
    ),
)

NO_RATE = "expected time stamps or a rate; give the sampling rate"

REFUSED = (
    Known(
        files=("formats/madlab_imucal_ferraris_session.csv",), message=("only a counter (n_samples)", NO_RATE)
    ),
    Known(
        files=("formats/scikit_kinematics_xio_33.csv",), message=("only a counter (Packet number)", NO_RATE)
    ),
    Known(files=("formats/st_unico_datalog.txt",), message=("no time column", NO_RATE)),
    Known(files=("formats/gnss_ins_sim_gyro_deg.csv",), message=("no time column", NO_RATE)),
    Known(files=("formats/gnss_ins_sim_accel.csv",), message=("no time column", NO_RATE)),
    Known(files=("formats/gnss_ins_sim_time.csv",), message=("it contains only times; write them",)),
    Known(
        files=("formats/px4_ecl_replay_iris_gps.csv",),
        message=("the 8 columns", "found columns: 0 = 4000, 1 = imu, 2 = -0.190396"),
    ),
    Known(
        files=("formats/invariant_ekf_tagged.txt",),
        message=("the 8 columns", "found columns: 0 = IMU, 1 = 0.004500"),
    ),
    Known(files=("formats/manifest.csv",), message=("the header has 7 names and the rows 8 cells",)),
    Known(files=("formats/euroc_kimera_sensor.yaml",), message=("columns have no header",)),
    *(
        Known(
            files=(f"real/mpu6050/{name}.csv",),
            message=("the unit of the accelerometer is unknown", "integer counts", "has 16384 counts per g"),
        )
        for name in ("example_data_tinit_calc", "imu_static_test", "example_data_calibration")
    ),
    Known(
        files=("real/mpu6050/imu_90_x_rot.csv",),
        message=("the unit of the gyroscope is unknown", "integer counts of an unknown scale"),
    ),
    *(
        Known(
            files=(f"real/mpu6050/published_6h_R_q_{axis}.csv",),
            message=("no rows of numbers",),
        )
        for axis in ("ax", "ay", "az", "gx", "gy", "gz")
    ),
    Known(files=("real/mpu6050/README.txt",), message=("no rows of numbers",)),
    *(
        Known(files=(f"formats/{name}",), message=("no topic carries",))
        for name in (
            "foxglove_example.bag",
            "foxglove_example_bz2.bag",
            "foxglove_example_lz4.bag",
            "rosbag2_wbag_0.mcap",
            "rosbag2_cdr_test_0.db3",
        )
    ),
)


@pytest.mark.parametrize("known", READ, ids=str)
def test_a_known_log_is_read(known: Known) -> None:
    """Axes, number of samples, rate and units must match the file."""
    recording = read(*(real_data(*file.split("/")) for file in known.files), **known.options)
    assert tuple(series.name for series in recording.series) == known.axes
    firsts = [series for series in recording.series if series.axis == "x"]
    for series in firsts:
        assert series.rate_hz == pytest.approx(known.rate, rel=known.within)
        if known.n:
            assert series.n == known.n
    for series, (value, factor) in zip(firsts, known.first, strict=bool(known.first)):
        assert series.samples[0] == pytest.approx(value * factor, rel=1e-8)


@pytest.mark.parametrize("known", REFUSED, ids=str)
def test_a_log_without_a_solution_is_refused(known: Known) -> None:
    """The message contains the file, its content and what to do."""
    paths = [real_data(*file.split("/")) for file in known.files]
    with pytest.raises(ImucalError) as caught:
        read(*paths, **known.options)
    message = str(caught.value)
    assert message.startswith(str(paths[0]))
    for part in known.message:
        assert part in message


def test_every_known_log_exists() -> None:
    """The tests above skip missing logs, so a renamed log would go unnoticed."""
    root = real_data()
    missing = [file for known in (*READ, *REFUSED) for file in known.files if not (root / file).exists()]
    assert missing == []
