"""Text logs in many real layouts, all written from the same samples."""

import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imucal.arrays import FloatArray
from imucal.units import G0

__all__ = ["RATE", "STYLES", "N", "Style", "Truth", "lines", "truth", "write"]

#: Number and rate of the samples.
N, RATE = 400, 100.0

#: Start in ns since 1970.
EPOCH = 1_700_000_000_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """Samples at rest in SI, shape (N, 3), and their times in ns from the first."""

    gyro: FloatArray
    accel: FloatArray
    ns: list[int]

    @property
    def deg(self) -> FloatArray:
        return np.degrees(self.gyro)

    @property
    def g(self) -> FloatArray:
        return self.accel / G0


def truth(seed: int = 5) -> Truth:
    """Return noise of a cheap sensor, with gravity on z."""
    rng = np.random.default_rng(seed)
    gyro = rng.normal(scale=2e-3, size=(N, 3)) + np.array([0.01, -0.02, 0.005])
    accel = rng.normal(scale=2e-2, size=(N, 3)) + np.array([0.1, -0.2, G0])
    return Truth(gyro=gyro, accel=accel, ns=[i * 10_000_000 for i in range(N)])


def cells(values: FloatArray) -> list[str]:
    """Return numbers as text with all digits."""
    return [repr(float(value)) for value in values]


def lines(header: str, *columns: Sequence[object], mark: str = ",") -> str:
    """Return the columns as rows, below the header unless it is empty."""
    rows = [mark.join(str(column[i]) for column in columns) for i in range(len(columns[0]))]
    return "\n".join([header, *rows] if header else rows) + "\n"


def xyz(values: FloatArray) -> list[list[str]]:
    """Return the three columns of a sensor."""
    return [cells(values[:, i]) for i in range(3)]


@dataclass(frozen=True, kw_only=True)
class Style:
    """A layout: how to write it, what the reader must report, and the options that the user must add."""

    name: str
    build: Callable[[Truth], str | bytes]
    file: str = "log.csv"
    options: dict[str, object] = field(default_factory=dict)
    gyro: bool = True
    accel: bool = True
    rate: float = RATE
    layout: str = ""
    tolerance: float = 1e-12


def write(style: Style, folder: Path) -> Path:
    """Write a log in a style."""
    content = style.build(truth())
    path = folder / style.file
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def stamps(t: Truth, unit: int, start: int = 0) -> list[int]:
    return [(start + ns) // unit for ns in t.ns]


def seconds(t: Truth, start: float = 0.0) -> list[str]:
    return [f"{start + ns * 1e-9:.6f}" for ns in t.ns]


ZERO = ["0"] * N


def euroc(t: Truth) -> str:
    header = (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]"
    )
    return lines(header, stamps(t, 1, EPOCH), *xyz(t.gyro), *xyz(t.accel))


def bare_euroc(t: Truth) -> str:
    header = "timestamp,w_RS_S_x,w_RS_S_y,w_RS_S_z,a_RS_S_x,a_RS_S_y,a_RS_S_z"
    return lines(header, stamps(t, 1, EPOCH), *xyz(t.gyro), *xyz(t.accel))


def kalibr(t: Truth) -> str:
    header = "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z"
    return lines(header, stamps(t, 1, EPOCH), *xyz(t.gyro), *xyz(t.accel))


ROSTOPIC = [
    *("field.orientation.x", "field.orientation.y", "field.orientation.z", "field.orientation.w"),
    *(f"field.orientation_covariance{i}" for i in range(9)),
]


def rostopic(t: Truth) -> str:
    covariance = [ZERO] * 9
    header = ",".join(
        [
            *("%time", "field.header.seq", "field.header.stamp", "field.header.frame_id", *ROSTOPIC),
            *(f"field.angular_velocity.{a}" for a in "xyz"),
            *(f"field.angular_velocity_covariance{i}" for i in range(9)),
            *(f"field.linear_acceleration.{a}" for a in "xyz"),
            *(f"field.linear_acceleration_covariance{i}" for i in range(9)),
        ]
    )
    stamp = stamps(t, 1, EPOCH)
    return lines(
        header,
        [s + 1_234_567 for s in stamp],
        range(N),
        stamp,
        ["imu"] * N,
        *[ZERO] * 3,
        ["1"] * N,
        *covariance,
        *xyz(t.gyro),
        *covariance,
        *xyz(t.accel),
        *covariance,
    )


def ros2_echo(t: Truth) -> str:
    covariance = [ZERO] * 9
    stamp = stamps(t, 1, EPOCH)
    text = lines(
        "",
        [s // 10**9 for s in stamp],
        [s % 10**9 for s in stamp],
        ["imu_link"] * N,
        *[ZERO] * 3,
        ["1.0"] * N,
        *covariance,
        *xyz(t.gyro),
        *covariance,
        *xyz(t.accel),
        *covariance,
    )
    return text.replace("\n", "\n\n")


def bagpy(t: Truth) -> str:
    header = ",".join(
        [
            *("Time", "header.seq", "header.stamp.secs", "header.stamp.nsecs", "header.frame_id"),
            *(f"orientation.{a}" for a in "xyzw"),
            *(f"angular_velocity.{a}" for a in "xyz"),
            *(f"linear_acceleration.{a}" for a in "xyz"),
        ]
    )
    stamp = stamps(t, 1, EPOCH)
    return lines(
        header,
        [repr(s * 1e-9) for s in stamp],
        range(N),
        [s // 10**9 for s in stamp],
        [s % 10**9 for s in stamp],
        ["imu"] * N,
        *[ZERO] * 4,
        *xyz(t.gyro),
        *xyz(t.accel),
    )


def rosbag_to_csv(t: Truth) -> str:
    header = (
        "rosbagTimestamp,header,seq,stamp,secs,nsecs,frame_id,orientation,x,y,z,w,"
        "angular_velocity,x,y,z,linear_acceleration,x,y,z"
    )
    stamp = stamps(t, 1, EPOCH)
    empty = [""] * N
    return lines(
        header,
        [s + 5_000 for s in stamp],
        empty,
        range(N),
        empty,
        [s // 10**9 for s in stamp],
        [s % 10**9 for s in stamp],
        ["imu"] * N,
        empty,
        *[ZERO] * 4,
        empty,
        *xyz(t.gyro),
        empty,
        *xyz(t.accel),
    )


def ros_acceleration(t: Truth) -> str:
    header = "Time,header.seq," + ",".join(f"accel.linear_acceleration.{a}" for a in "xyz")
    return lines(header, [repr((EPOCH + ns) * 1e-9) for ns in t.ns], range(N), *xyz(t.accel))


def plotjuggler(t: Truth) -> str:
    """Write rows of two topics in turn; the sensor's cells are empty in every other row."""
    header = ",".join(
        [
            *("__time", "/odom/twist/linear/x"),
            *(f"/imu/data/angular_velocity/{a}" for a in "xyz"),
            *(f"/imu/data/linear_acceleration/{a}" for a in "xyz"),
        ]
    )
    rows = [header]
    for i in range(N):
        now = 1_700_000_000 + t.ns[i] * 1e-9
        rows.append(",".join([f"{now:.6f}", "", *cells(t.gyro[i]), *cells(t.accel[i])]))
        rows.append(f"{now + 0.003:.6f},0.5,,,,,,")
    return "\n".join(rows) + "\n"


def xsens(t: Truth) -> str:
    preamble = "// Start Time: Unknown\n// Update Rate: 100.0Hz\n// Firmware Version: 4.0.2\n"
    header = "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"
    counter = [(65_400 + i) % 65_536 for i in range(N)]
    return preamble + lines(header, counter, [""] * N, *xyz(t.accel), *xyz(t.gyro), mark="\t")


def xsens_plain(t: Truth) -> str:
    preamble = "// Start Time: Unknown\n// Update Rate: 100.0Hz\n"
    return preamble + lines(
        "Acc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z", *xyz(t.accel), *xyz(t.gyro), mark="\t"
    )


def xsens_ticks(t: Truth) -> str:
    header = "PacketCounter\tSampleTimeFine\tAcc_X\tAcc_Y\tAcc_Z\tGyr_X\tGyr_Y\tGyr_Z"
    ticks = [(2**32 - 5_000 + i * 100) % 2**32 for i in range(N)]
    return "// Start Time: x\n" + lines(header, range(N), ticks, *xyz(t.accel), *xyz(t.gyro), mark="\t")


def xsens_dot(t: Truth) -> str:
    header = (
        "PacketCounter,SampleTimeFine,Euler_X,Euler_Y,Euler_Z,FreeAcc_X,FreeAcc_Y,FreeAcc_Z,"
        "Acc_X,Acc_Y,Acc_Z,Gyr_X,Gyr_Y,Gyr_Z"
    )
    micro = [(2**32 - 1_000_000 + ns // 1000) % 2**32 for ns in t.ns]
    return "DeviceTag:,D4:CA:6E\n" + lines(header, range(N), micro, *[ZERO] * 6, *xyz(t.accel), *xyz(t.deg))


def px4(t: Truth) -> str:
    header = (
        "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt,accelerometer_timestamp_relative,"
        "accelerometer_m_s2[0],accelerometer_m_s2[1],accelerometer_m_s2[2],accelerometer_integral_dt"
    )
    return lines(
        header, stamps(t, 1000, 10**10), *xyz(t.gyro), ["4000"] * N, ZERO, *xyz(t.accel), ["4000"] * N
    )


def px4_gyro(t: Truth) -> str:
    header = "timestamp,timestamp_sample,device_id,x,y,z,temperature,error_count"
    micro = stamps(t, 1000, 10**10)
    return lines(header, [m + 40 for m in micro], micro, ["2883602"] * N, *xyz(t.gyro), ["45.5"] * N, ZERO)


ARDUPILOT = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"


def ardupilot(t: Truth) -> str:
    rest = [ZERO, ZERO, ["31.5"] * N, *[ZERO] * 4]
    return lines(ARDUPILOT, stamps(t, 1000, 10**9), ZERO, *xyz(t.gyro), *xyz(t.accel), *rest)


def two_ardupilots(t: Truth) -> str:
    rows = [ARDUPILOT]
    for i in range(N):
        for instance, factor in ((0, 2.0), (1, 1.0)):
            values = cells(np.concatenate([t.gyro[i], t.accel[i]]) * factor)
            rows.append(
                ",".join([str(10**6 + t.ns[i] // 1000), str(instance), *values, "0,0,31.5,1,1,1000,1000"])
            )
    return "\n".join(rows) + "\n"


def ardupilot_log(t: Truth) -> str:
    rows = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        f"FMT, 163, 52, IMU, QBffffffIIfBBHH, {ARDUPILOT}",
        "FMT, 130, 45, GPS, BIHBcLLeeEefI, TimeUS,Status,GMS",
        "PARM, 100, INS_ACC_ID, 1.0",
    ]
    for i in range(N):
        values = ", ".join(cells(np.concatenate([t.gyro[i], t.accel[i]])))
        rows.append(f"IMU, {10**6 + t.ns[i] // 1000}, 0, {values}, 0, 0, 31.5, 1, 1, 1000, 1000")
        if i % 3 == 0:
            rows.append(f"GPS, {10**6 + t.ns[i] // 1000}, 3, 123")
    return "\n".join(rows) + "\n"


def gnss_logger(t: Truth) -> str:
    fields = "utcTimeMillis,elapsedRealtimeNanos"
    rows = ["# Version: v3.0.6.4 Platform: 13", "# Raw,utcTimeMillis,TimeNanos,LeapSecond,BiasNanos,Svid"]
    for tag, unit, bias in (
        ("UncalAccel", "Mps2", "Bias"),
        ("UncalGyro", "RadPerSec", "Drift"),
        ("UncalMag", "MicroT", "Bias"),
    ):
        names = ",".join(f"{name}{axis}{unit}" for name in (tag, bias) for axis in "XYZ")
        rows.append(f"# {tag},{fields},{names}")
    for i in range(N):
        utc, boot = (EPOCH + t.ns[i]) // 10**6, 10**9 + t.ns[i]
        for tag, values in (("UncalAccel", t.accel[i]), ("UncalGyro", t.gyro[i]), ("UncalMag", t.gyro[i])):
            rows.append(f"{tag},{utc},{boot},{','.join(cells(values))},0.0,0.0,0.0")
        if i % 5 == 0:
            rows.append(f"Raw,{utc},{boot},18,0.1,{i % 30}")
    return "\n".join(rows) + "\n"


def betaflight(t: Truth) -> str:
    preamble = '"Product","Blackbox flight data recorder"\n"acc_1G","2048"\n'
    header = (
        "loopIteration,time,axisP[0],axisP[1],axisP[2],setpoint[0],setpoint[1],setpoint[2],"
        "gyroADC[0],gyroADC[1],gyroADC[2],accSmooth[0],accSmooth[1],accSmooth[2],motor[0]"
    )
    counts = [[str(round(v * 2048)) for v in t.g[:, i]] for i in range(3)]
    return preamble + lines(header, range(N), stamps(t, 1000, 10**9), *[ZERO] * 6, *xyz(t.deg), *counts, ZERO)


def phyphox(t: Truth) -> str:
    header = '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)","Absolute (rad/s)"'
    return lines(header, seconds(t), *xyz(t.gyro), ZERO)


def phyphox_comma(t: Truth) -> str:
    header = '"Time (s)";"Acceleration x (m/s^2)";"Acceleration y (m/s^2)";"Acceleration z (m/s^2)"'
    return lines(header, seconds(t), *xyz(t.accel), mark=";").replace(".", ",")


def phyphox_zip(t: Truth) -> bytes:
    return _zip(
        {
            "Gyroscope.csv": phyphox(t),
            "Accelerometer.csv": phyphox_comma(t),
            "Linear Accelerometer.csv": phyphox_comma(t),
            "meta/device.csv": '"property","value"\n"version","1"\n',
        }
    )


def sensor_logger(t: Truth, values: FloatArray) -> str:
    """Write the axes in the order of the app: z, y, x."""
    return lines("time,seconds_elapsed,z,y,x", stamps(t, 1, EPOCH), seconds(t), *xyz(values)[::-1])


def sensor_logger_zip(t: Truth) -> bytes:
    return _zip(
        {
            "Gyroscope.csv": sensor_logger(t, t.gyro),
            "Accelerometer.csv": sensor_logger(t, t.accel * 0.0),
            "TotalAcceleration.csv": sensor_logger(t, t.accel),
            "Metadata.csv": "version,device\n1,phone\n",
        }
    )


def _zip(members: dict[str, str]) -> bytes:
    import io

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, text in members.items():
            archive.writestr(name, text)
    return buffer.getvalue()


def core_motion(t: Truth) -> str:
    """Write what apps log of Core Motion: seconds since the start of the phone, rad/s and g."""
    header = "timestamp,rotationRateX,rotationRateY,rotationRateZ,accelerationX,accelerationY,accelerationZ"
    return lines(header, seconds(t, 81234.5), *xyz(t.gyro), *xyz(t.g))


def sensorlog(t: Truth) -> str:
    """Write the separate clocks of the iPhone's sensors; one is 3 ms late."""
    header = (
        "loggingTime(txt),loggingSample(N),accelerometerTimestamp_sinceReboot(s),"
        "accelerometerAccelerationX(G),accelerometerAccelerationY(G),accelerometerAccelerationZ(G),"
        "gyroTimestamp_sinceReboot(s),gyroRotationX(rad/s),gyroRotationY(rad/s),gyroRotationZ(rad/s),"
        "motionTimestamp_sinceReboot(s),motionUserAccelerationX(G),motionRotationRateX(rad/s)"
    )
    text = [f"2020-01-01T00:00:{i // 100:02d}.{i % 100:02d}0+0100" for i in range(N)]
    return lines(
        header,
        text,
        range(N),
        seconds(t, 1000.003),
        *xyz(t.g),
        seconds(t, 1000.0),
        *xyz(t.gyro),
        seconds(t, 1000.0),
        ZERO,
        ZERO,
    )


def androsensor(t: Truth) -> bytes:
    header = ";".join(
        [
            *(f"ACCELEROMETER {a} (m/s²)" for a in "XYZ"),
            *(f"LINEAR ACCELERATION {a} (m/s²)" for a in "XYZ"),
            *(f"GYROSCOPE {a} (rad/s)" for a in "XYZ"),
            *("Time since start in ms ", "YYYY-MO-DD HH-MI-SS_SSS"),
        ]
    )
    text = [f"2019-01-01 01:01:{i // 100:02d}:{i % 100:02d}0" for i in range(N)]
    table = lines(header, *xyz(t.accel), *[ZERO] * 3, *xyz(t.gyro), stamps(t, 1_000_000), text, mark=";")
    return table.encode("latin-1")


def realsense(t: Truth) -> str:
    rows = [
        "Configuration:",
        "Stream Type,Stream Name,Format,FPS,Width,Height",
        "Gyro,Gyro,MOTION_XYZ32F,100,0,0",
        "",
        "Stream Type,Index,F#,HW Timestamp (ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z",
    ]
    start = 1_645_552_774_232.0
    for i in range(N):
        now = start + t.ns[i] * 1e-6
        rows.append(",".join(["Gyro,0", str(i), f"{now:.6f}", f"{now % 1e6:.3f}", *cells(t.gyro[i])]))
    rows.append("Stream Type,Index,F#,HW Timestamp (ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z")
    for i in range(N):
        now = start + t.ns[i] * 1e-6 + 2
        rows.append(",".join(["Accel,0", str(i), f"{now:.6f}", f"{now % 1e6:.3f}", *cells(t.accel[i])]))
    return "\n".join(rows) + "\n"


def unico(t: Truth) -> str:
    header = "time[us],acc_x[mg],acc_y[mg],acc_z[mg],gyro_x[mdps],gyro_y[mdps],gyro_z[mdps]"
    return "STEVAL-MKI\n\n" + lines(header, stamps(t, 1000), *xyz(t.g * 1e3), *xyz(t.deg * 1e3))


def unico_tab(t: Truth) -> str:
    header = "A_X [g]\tA_Y [g]\tA_Z [g]\tG_X [mdps]\tG_Y [mdps]\tG_Z [mdps]\t"
    padded = [[f"  {cell}" for cell in column] for column in (*xyz(t.g), *xyz(t.deg * 1e3))]
    return "STEVAL-STWINKT1 (ISM330DHCX) \n\n\n" + lines(header, *padded, [""] * N, mark="\t")


def witmotion(t: Truth) -> str:
    header = "Chiptime\tax(g)\tay(g)\taz(g)\twx(deg/s)\twy(deg/s)\twz(deg/s)\tAngleX(deg)\tT(°)"
    text = [f"2023-5-6 23:59:{57 + i // 100:02d}.{10 * (i % 100)}" for i in range(300)]
    text += [f"2023-5-7 00:00:00.{10 * i}" for i in range(100)]
    text = [f"{head}.{int(tail):03d}" for head, _, tail in (entry.rpartition(".") for entry in text)]
    return lines(header, text, *xyz(t.g), *xyz(t.deg), ZERO, ["25.1"] * N, mark="\t")


def xio(t: Truth) -> str:
    header = ",".join(
        [
            "Time (s)",
            *(f"Gyroscope {a} (deg/s)" for a in "XYZ"),
            *(f"Accelerometer {a} (g)" for a in "XYZ"),
            *(f"Magnetometer {a} (G)" for a in "XYZ"),
        ]
    )
    return lines(header, seconds(t), *xyz(t.deg), *xyz(t.g), *[ZERO] * 3)


def microstrain(t: Truth) -> str:
    preamble = (
        "FILE_INFO\nListSeparator=comma\nDecimalSeparator=period\n\nSESSION_INFO\n"
        "StartTime,02/10/2017 16:13:52\n\nDATA_START\n"
    )
    header = (
        "GPS TFlags,GPS Week,GPS TOW,Roll [x800C],X Accel [x8004],Y Accel [x8004],Z Accel [x8004],"
        "X Gyro [x8005],Y Gyro [x8005],Z Gyro [x8005],Lat [x8103],Long [x8103]"
    )
    tow = [f"{345_600 + ns * 1e-9:.3f}" for ns in t.ns]
    empty = [""] * N
    return preamble + lines(header, ["5"] * N, ["1969"] * N, tow, ZERO, *xyz(t.g), *xyz(t.gyro), empty, empty)


def sensorconnect(t: Truth) -> str:
    header = (
        "Time,scaledAccelX,scaledAccelY,scaledAccelZ,scaledGyroX,scaledGyroY,scaledGyroZ,"
        "estLinearAccelX,estLinearAccelY,estLinearAccelZ"
    )
    return lines(header, stamps(t, 1, EPOCH), *xyz(t.g), *xyz(t.gyro), *[ZERO] * 3)


def crossbow(t: Truth) -> str:
    header = "time,roll,pitch,xRate,yRate,zRate,xAccel,yAccel,zAccel"
    return lines(header, seconds(t), ZERO, ZERO, *xyz(t.deg), *xyz(t.g))


def instinct(t: Truth) -> str:
    header = (
        "Time [s],GpsCycle,GpsWeek,TimeStartup,UnCompMagX,UnCompMagY,UnCompMagZ,UnCompAccX,UnCompAccY,"
        "UnCompAccZ,UnCompGyroX,UnCompGyroY,UnCompGyroZ,Temperature"
    )
    start = stamps(t, 1, 10**9)
    return lines(
        header, seconds(t), ZERO, ZERO, start, *[ZERO] * 3, *xyz(t.accel), *xyz(t.gyro), ["21.5"] * N
    )


def sentence(body: str) -> str:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}"


def vnymr(t: Truth) -> str:
    rows = []
    for i in range(N):
        values = ",".join(f"{v:+.6f}" for v in [*t.accel[i], *t.gyro[i]])
        rows.append(
            f"{1000 + t.ns[i] * 1e-9:.6f},"
            + sentence(f"VNYMR,+006.380,+000.023,-001.953,+1.0,-0.2,+3.0,{values}")
        )
    return "\n".join(rows) + "\n"


def vnimu(t: Truth) -> str:
    rows = []
    for i in range(N):
        values = ",".join(f"{v:+.6f}" for v in [*t.accel[i], *t.gyro[i]])
        rows.append(sentence(f"VNIMU,+1.0,-0.2,+3.0,{values},+21.5,+101.3"))
        rows.append(sentence("VNYPR,+006.380,+000.023,-001.953"))
    return "\n".join(rows) + "\n"


def shimmer(t: Truth) -> str:
    header = "\t".join(
        [
            "Timestamp_Unix_CAL",
            *(f"Low_Noise_Accelerometer_{a}_CAL" for a in "XYZ"),
            *(f"Gyroscope_{a}_CAL" for a in "XYZ"),
        ]
    )
    units = "\t".join(["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3])
    now = [f"{EPOCH // 10**6 + ns * 1e-6:.4f}" for ns in t.ns]
    return "sep=\\t\n" + lines(f"{header}\n{units}", now, *xyz(t.accel), *xyz(t.deg), mark="\t")


def kitti(t: Truth) -> str:
    return lines(
        "", *[ZERO] * 11, *xyz(t.accel), *[ZERO] * 3, *xyz(t.gyro), *[ZERO] * 5, *[["4"] * N] * 5, mark=" "
    )


def json_lines(t: Truth) -> str:
    """Write a structure for each sensor, numbers with all digits, and a text with delimiters."""
    rows = (
        {
            "time_ns": EPOCH + ns,
            "gyro": dict(zip("xyz", w, strict=True)),
            "accel": dict(zip("xyz", f, strict=True)),
            "note": 'at "rest", 20 °C\n',
            "ok": True,
        }
        for ns, w, f in zip(t.ns, t.gyro.tolist(), t.accel.tolist(), strict=True)
    )
    return "".join(json.dumps(row) + "\n" for row in rows)


def json_vectors(t: Truth) -> str:
    """Write a list for each sensor, in separate objects with a time each."""
    rows = []
    for ns, w, f in zip(t.ns, t.gyro.tolist(), t.accel.tolist(), strict=True):
        rows += [{"timestamp": EPOCH + ns, "gyro_rad_s": w}, {"timestamp": EPOCH + ns, "accel_m_s2": f}]
    return "".join(json.dumps(row) + "\n" for row in rows)


def json_tagged(t: Truth) -> str:
    """Write like a phone's logger: objects of all sensors have the same members, with numbers as texts."""
    rows = []
    for ns, w, f in zip(t.ns, t.gyro.tolist(), t.accel.tolist(), strict=True):
        for sensor, values in (("gyroscope", w), ("accelerometer", f)):
            axes = dict(zip("xyz", map(repr, values), strict=True))
            rows.append({"sensor": sensor, "time": str(EPOCH + ns), **axes})
    return "".join(json.dumps(row) + "\n" for row in rows)


def own_micros(t: Truth) -> str:
    return lines("ustime gx gy gz ax ay az", stamps(t, 1000, 10**9), *xyz(t.gyro), *xyz(t.accel), mark=" ")


def own_suffixes(t: Truth) -> str:
    return lines("t_s,gx_dps,gy_dps,gz_dps,ax_g,ay_g,az_g", seconds(t), *xyz(t.deg), *xyz(t.g))


def own_deg_s(t: Truth) -> str:
    header = "timestamp_ms,ax_g,ay_g,az_g,roll_deg,pitch_deg,gx_deg_s,gy_deg_s,gz_deg_s"
    return lines(header, stamps(t, 10**6), *xyz(t.g), ZERO, ZERO, *xyz(t.deg))


def own_pqr(t: Truth) -> str:
    return lines("t,Ax,Ay,Az,p,q,r", seconds(t), *xyz(t.accel), *xyz(t.gyro))


def own_wf(t: Truth) -> str:
    return lines("time,f_x,f_y,f_z,w_x,w_y,w_z", seconds(t), *xyz(t.accel), *xyz(t.gyro))


def own_plain(t: Truth) -> str:
    return lines("time,gx,gy,gz,ax,ay,az", seconds(t), *xyz(t.gyro), *xyz(t.accel))


def own_counts(t: Truth) -> str:
    counts = [[str(round(v * 131)) for v in t.deg[:, i]] for i in range(3)]
    gravity = [[str(round(v * 16384)) for v in t.g[:, i]] for i in range(3)]
    return "Fs,100\nLogging Type,1\n" + lines("ax,ay,az,gx,gy,gz", *gravity, *counts)


def repoimu(t: Truth) -> str:
    header = "Time;Accelerometer [m/s^2];;;Gyroscope [rad/s];;\n;X;Y;Z;X;Y;Z"
    return lines(header, seconds(t), *xyz(t.accel), *xyz(t.gyro), mark=";")


def repoimu_semicolons(t: Truth) -> str:
    """Write quaternion, magnetometer, a second row with units, and a semicolon at the end of each line."""
    ones = [["0.5"] * N] * 4
    groups = "Time;Vicon quat;;;;IMU acc;;;IMU gyr;;;IMU mag;;"
    axes = "[s];W;X;Y;Z;X [m/s^2];Y [m/s^2];Z [m/s^2];X [rad/s];Y [rad/s];Z [rad/s];X;Y;Z"
    columns = [seconds(t), *ones, *xyz(t.accel), *xyz(t.gyro), *ones[:3]]
    return lines(f"{groups};\n{axes};", *columns, [""] * N, mark=";")


def matrix(t: Truth) -> str:
    """Write rows that end like rows of a matrix in MATLAB."""
    return lines("", seconds(t), *xyz(t.gyro), *xyz(t.accel), mark=" ").replace("\n", ";\n")


def commas_and_semicolon(t: Truth) -> str:
    header = "time (s),gx (rad/s),gy (rad/s),gz (rad/s),ax (g),ay (g),az (g)"
    return lines(header, seconds(t), *xyz(t.gyro), *xyz(t.g)).replace("\n", ";\n")


def quoted_commas(t: Truth) -> str:
    """Write numbers like a spreadsheet in a country with decimal commas."""
    columns = [seconds(t), *xyz(t.gyro), *xyz(t.accel)]
    quoted = [['"' + str(cell).replace(".", ",") + '"' for cell in column] for column in columns]
    return lines("time (s),gx (rad/s),gy (rad/s),gz (rad/s),ax (m/s^2),ay (m/s^2),az (m/s^2)", *quoted)


def two_bytes(t: Truth) -> bytes:
    """Write UTF-16 without a byte order mark."""
    return quoted_commas(t).encode("utf-16-le")


def metawear(t: Truth) -> str:
    header = "epoc (ms),timestamp (+0700),elapsed (s),x-axis (deg/s),y-axis (deg/s),z-axis (deg/s)"
    text = [f"2018-09-06T10:00:{i // 100:02d}.{i % 100:02d}0" for i in range(N)]
    return lines(header, stamps(t, 10**6, EPOCH), text, seconds(t), *xyz(t.deg))


def spaces(t: Truth) -> str:
    axes = [f"{a}accel (m/s^2)" for a in "XYZ"] + [f"{a}gyro (rad/s)" for a in "XYZ"]
    header = ", ".join(["Time (s)", *axes])
    return lines(header, seconds(t), *xyz(t.accel), *xyz(t.gyro), mark=", ")


def pipes(t: Truth) -> str:
    return lines(
        "time|gyro_x|gyro_y|gyro_z|acc_x|acc_y|acc_z", seconds(t), *xyz(t.gyro), *xyz(t.accel), mark="|"
    )


def tagged(t: Truth) -> str:
    rows = []
    for i in range(N):
        now = t.ns[i] // 1000
        rows.append(f"{now},mag,0.19,-0.08,0.42")
        rows.append(",".join([str(now), "imu", *cells(t.accel[i]), *cells(t.gyro[i])]))
        if i % 5 == 0:
            rows.append(f"{now},baro,487.7")
    return "\n".join(rows) + "\n"


def headless(t: Truth) -> str:
    return lines("", seconds(t), *xyz(t.gyro), *xyz(t.accel), mark="  ")


def time_of_day(t: Truth) -> str:
    clock = [f"23:59:{58 + i // 100:02d}.{i % 100:02d}" for i in range(200)]
    clock += [f"00:00:{i // 100:02d}.{i % 100:02d}" for i in range(200)]
    header = "Time,gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s),acc_x (g),acc_y (g),acc_z (g)"
    return lines(header, clock, *xyz(t.gyro), *xyz(t.g))


DEG: dict[str, object] = {"gyro_unit": "deg/s"}

STYLES: tuple[Style, ...] = (
    Style(name="EuRoC", build=euroc, layout="EuRoC", tolerance=0),
    Style(name="EuRoC without units", build=bare_euroc, layout="EuRoC", tolerance=0),
    Style(name="Kalibr", build=kalibr, layout="Kalibr", tolerance=0),
    Style(name="rostopic echo -p", build=rostopic, layout="ROS", tolerance=0),
    Style(name="ros2 topic echo --csv", build=ros2_echo, layout="ROS", tolerance=0),
    Style(name="bagpy", build=bagpy, layout="ROS", tolerance=0),
    Style(name="rosbag_to_csv", build=rosbag_to_csv, layout="ROS", tolerance=0),
    Style(name="ROS acceleration", build=ros_acceleration, layout="ROS", gyro=False, tolerance=0),
    Style(name="PlotJuggler", build=plotjuggler, layout="ROS", tolerance=0),
    Style(name="Xsens MT Manager", build=xsens, file="log.txt", layout="Xsens", tolerance=0),
    Style(name="Xsens without counter", build=xsens_plain, file="log.txt", layout="Xsens", tolerance=0),
    Style(name="Xsens ticks", build=xsens_ticks, file="log.txt", layout="Xsens", tolerance=0),
    Style(name="Xsens DOT", build=xsens_dot, layout="Xsens DOT"),
    Style(name="PX4 ulog2csv", build=px4, layout="PX4", tolerance=0),
    Style(
        name="PX4 sensor_gyro",
        build=px4_gyro,
        file="log_sensor_gyro_0.csv",
        layout="PX4",
        accel=False,
        tolerance=0,
    ),
    Style(name="ArduPilot", build=ardupilot, layout="ArduPilot", tolerance=0),
    Style(
        name="ArduPilot, second of two",
        build=two_ardupilots,
        layout="ArduPilot",
        options={"columns": "t=0,g=2:5@I:1,a=5:8@I:1"},
        tolerance=0,
    ),
    Style(name="Betaflight", build=betaflight, layout="Betaflight", tolerance=5e-3),
    Style(name="phyphox gyroscope", build=phyphox, accel=False, tolerance=0),
    Style(name="phyphox decimal comma", build=phyphox_comma, gyro=False, tolerance=0),
    Style(name="phyphox zip", build=phyphox_zip, file="phyphox.zip", tolerance=0),
    Style(
        name="Sensor Logger",
        build=lambda t: sensor_logger(t, t.gyro),
        file="Gyroscope.csv",
        layout="Sensor Logger",
        accel=False,
        tolerance=0,
    ),
    Style(
        name="Sensor Logger zip", build=sensor_logger_zip, file="log.zip", layout="Sensor Logger", tolerance=0
    ),
    Style(name="Core Motion", build=core_motion, layout="Core Motion"),
    Style(name="SensorLog", build=sensorlog, layout="SensorLog"),
    Style(name="AndroSensor", build=androsensor, tolerance=0),
    Style(name="RealSense", build=realsense, layout="RealSense", tolerance=0),
    Style(name="ST Unico", build=unico),
    Style(name="ST Unico tabs", build=unico_tab, file="log.txt", options={"rate_hz": 100.0}),
    Style(name="WitMotion", build=witmotion, file="log.txt"),
    Style(name="x-io", build=xio),
    Style(name="MicroStrain", build=microstrain, layout="MicroStrain"),
    Style(name="SensorConnect", build=sensorconnect, layout="MicroStrain"),
    Style(name="Crossbow", build=crossbow, options=DEG),
    Style(name="VectorNav INSTINCT", build=instinct, layout="VectorNav", tolerance=0),
    Style(name="Shimmer", build=shimmer),
    Style(
        name="KITTI",
        build=kitti,
        file="oxts.txt",
        options={"columns": "g=17:20,a=11:14", "rate_hz": 100.0, "gyro_unit": "rad/s"},
        tolerance=0,
    ),
    Style(name="ustime", build=own_micros, file="log.txt", tolerance=0),
    Style(name="unit suffixes", build=own_suffixes),
    Style(name="deg_s", build=own_deg_s),
    Style(name="p, q, r", build=own_pqr, tolerance=0),
    Style(name="f_x, w_x", build=own_wf, tolerance=0),
    Style(name="time,gx,gy,gz,ax,ay,az", build=own_plain, tolerance=0),
    Style(
        name="counts",
        build=own_counts,
        options={"gyro_scale": float(np.radians(1 / 131))},
        tolerance=4e-4,  # half a count of 1/16384 g
    ),
    Style(name="REPOIMU", build=repoimu, tolerance=0),
    Style(name="REPOIMU with semicolons at the end", build=repoimu_semicolons, tolerance=0),
    Style(
        name="matrix with semicolons",
        build=matrix,
        file="log.txt",
        options={"columns": "t=0,g=1:4,a=4:7", "gyro_unit": "rad/s"},
        tolerance=0,
    ),
    Style(name="commas and a semicolon", build=commas_and_semicolon),
    Style(name="decimal commas in quotes", build=quoted_commas, tolerance=0),
    Style(name="UTF-16 without a mark", build=two_bytes, tolerance=0),
    Style(name="MetaWear", build=metawear, accel=False),
    Style(name="blanks behind commas", build=spaces, tolerance=0),
    Style(name="pipes", build=pipes, tolerance=0),
    Style(name="tagged rows", build=tagged, options={"columns": "t=0,g=5:8@imu,a=2:5@imu"}, tolerance=0),
    Style(name="JSON lines", build=json_lines, file="log.jsonl", tolerance=0),
    Style(name="JSON lines of vectors", build=json_vectors, file="log.json", tolerance=0),
    Style(name="JSON lines of sensors", build=json_tagged, file="log.jsonl", tolerance=0),
    Style(name="no header", build=headless, options={"columns": "t=0,g=1:4,a=4:7"}, tolerance=0),
    Style(name="time of day", build=time_of_day),
)
