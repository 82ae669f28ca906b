"""Messages: pictures in every encoding, joints by name, readings of every robot there and back,
against the classes of rosbags alone.
"""

import copy

import cv2
import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

import vstestbed as vs
from vstestbed.apps.ros import messages as m
from vstestbed.apps.ros.law import Senses
from vstestbed.camera import Fisheye, Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.robots import Reading
from vstestbed.robots.flight import FlightEstimate, FlightReading
from vstestbed.targets.picture import decoded

ROS = get_typestore(Stores.ROS2_JAZZY)
PICTURE = np.random.default_rng(1).integers(0, 256, (6, 8, 3), np.uint8)


def sent(message):
    """A message as another program of ROS 2 reads it."""
    return ROS.deserialize_cdr(m.to_cdr(message), message.__msgtype__)


def as_image(data, encoding, width, step, big=0):
    data = np.frombuffer(data, np.uint8)
    return m.made(
        m.IMAGE,
        header=m.header(1.5, "cam"),
        height=6,
        width=width,
        encoding=encoding,
        is_bigendian=big,
        step=step,
        data=data,
    )


def test_a_picture_is_what_others_read():
    there = sent(m.image(1.25, PICTURE))
    assert (there.height, there.width, there.encoding, there.step, there.header.frame_id) == (
        6,
        8,
        "rgb8",
        24,
        "camera_optical_frame",
    )
    assert (there.header.stamp.sec, there.header.stamp.nanosec) == (1, 250_000_000)
    np.testing.assert_array_equal(there.data.reshape(6, 8, 3), PICTURE)


def test_pictures_of_every_encoding_are_read():
    grey = PICTURE[..., :1]
    padded = np.concatenate([PICTURE.reshape(6, 24), np.full((6, 5), 9, np.uint8)], axis=1)
    alpha = np.concatenate([PICTURE[..., ::-1], np.full((6, 8, 1), 7, np.uint8)], axis=2)
    for data, encoding, step, expected in (
        (PICTURE, "rgb8", 24, PICTURE),
        (PICTURE[..., ::-1], "bgr8", 24, PICTURE),
        (alpha, "bgra8", 32, PICTURE),
        (grey, "mono8", 8, grey.repeat(3, axis=2)),
        (padded, "rgb8", 29, PICTURE),
    ):
        np.testing.assert_array_equal(
            m.picture_of(as_image(data.tobytes(), encoding, 8, step)), expected, err_msg=encoding
        )
    png = cv2.imencode(".png", PICTURE[..., ::-1])[1].ravel()
    compressed = m.made(m.COMPRESSED, header=m.header(0.0, ""), format="png", data=png)
    np.testing.assert_array_equal(m.picture_of(compressed), PICTURE)
    millimetres = np.arange(48, dtype="<u2").reshape(6, 8) * 100
    np.testing.assert_allclose(
        m.depth_of(as_image(millimetres.tobytes(), "16UC1", 8, 16)), millimetres / 1000
    )
    np.testing.assert_allclose(
        m.depth_of(as_image(millimetres.byteswap().tobytes(), "16UC1", 8, 16, big=1)),
        millimetres / 1000,
    )
    # at the end of its numbers: farther than any, or nothing
    millimetres_far = np.full((8, 16), 65535, np.uint16)
    assert np.isnan(m.depth_of(as_image(millimetres_far.tobytes(), "16UC1", 8, 16))).all()
    np.testing.assert_allclose(
        m.depth_of(sent(m.depth_image(0.0, millimetres.astype(np.float32)))), millimetres
    )


def test_pictures_that_are_none_are_refused():
    for message, words in (
        (as_image(b"\0" * 48, "yuv422", 8, 8), "must be one of rgb8"),
        (as_image(b"\0" * 40, "rgb8", 8, 24), "has 40 bytes"),
        (
            m.made(
                m.COMPRESSED, header=m.header(0.0, ""), format="h264", data=np.zeros(9, np.uint8)
            ),
            "neither JPEG nor PNG",
        ),
    ):
        with pytest.raises(ParameterError, match=words):
            m.picture_of(message)


def test_a_camera_info_projects_as_the_camera_does():
    for camera, project in (
        (Perspective(distortion=(-0.2, 0.05, 0.001, -0.002, 0.01), principal_px=(330, 230)), None),
        (
            Fisheye(coefficients=(0.03, -0.004, 0.002, -0.0005), fov_deg=120),
            cv2.fisheye.projectPoints,
        ),
    ):
        info = sent(m.camera_info(0.0, camera))
        p = np.random.default_rng(2).uniform([-0.4, -0.3, 0.9], [0.4, 0.3, 1.5], (20, 3))
        K, d = info.k.reshape(3, 3), np.array(info.d)
        zero = np.zeros(3)
        uv = (
            cv2.projectPoints(p, zero, zero, K, d)
            if project is None
            else project(p[:, None], zero, zero, K, d)
        )[0][:, 0]
        np.testing.assert_allclose(uv.reshape(-1, 2), camera.project(p), atol=1e-6)
        assert info.distortion_model == ("plumb_bob" if project is None else "equidistant")
    assert m.camera_info(0.0, vs.load("car_catadioptric").camera) is None


def test_joints_go_by_their_names():
    message = m.made(
        m.JOINTS,
        header=m.header(0.0, ""),
        name=["gripper", "b", "a"],
        position=np.array([9.0, 2.0, 1.0]),
        velocity=np.array([0.0, 20.0, 10.0]),
        effort=np.zeros(0),
    )
    q, qd = m.joints_of(message, ("a", "b"))
    assert q.tolist() == [1, 2] and qd.tolist() == [10, 20]
    with pytest.raises(ParameterError, match="have no c"):
        m.joints_of(message, ("a", "c"))
    message.velocity = np.zeros(0)
    assert np.isnan(m.joints_of(message, ("a", "b"))[1]).all()


def test_joints_that_are_told_twice_or_velocities_of_some_are_passed_over_and_counted():
    """The last of two positions was taken, and velocities of two of three joints were none."""
    robot = vs.load("arm_ibvs").robot
    right = m.readings(1.0, robot, vs.Reading(robot.start_joints(), np.zeros(6)))["joint_states"]
    senses = Senses(robot, 1.0)
    senses.hear("joint_states", right)
    twice = copy.deepcopy(right)
    twice.header = m.header(1.1, "")
    twice.name = [*right.name, right.name[0]]
    twice.position = np.append(right.position, 1.0)
    twice.velocity = np.append(right.velocity, 0.0)
    senses.hear("joint_states", twice)
    some = copy.deepcopy(right)
    some.header, some.velocity = m.header(1.2, ""), right.velocity[:2]
    senses.hear("joint_states", some)
    assert senses.at().q.tolist() == right.position.tolist()
    ((topic, number, *_, words, _),) = senses.passed.rows()
    assert (topic, number) == ("joint_states", "2")
    assert f"have {right.name[0]} more than once" in words  # the first one's
    with pytest.raises(ParameterError, match="have 2 velocities of 6 joints; valid: all or none"):
        m.joints_of(some, robot.joints)


def test_what_opencv_says_of_a_broken_picture_stays_out_of_the_terminal(capfd, tmp_path):
    """Its log wrote lines of its own beside the sentence."""
    level = cv2.utils.logging.getLogLevel()
    raw = np.frombuffer(b"GIF89a" + b"\0" * 100, np.uint8)
    message = m.made(m.COMPRESSED, header=m.header(0.0, ""), format="gif", data=raw)
    (tmp_path / "a.png").write_bytes(raw.tobytes())
    with pytest.raises(ParameterError, match="neither JPEG nor PNG"):
        m.picture_of(message)
    with pytest.raises(ParameterError, match="damaged"):
        decoded(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")
    assert cv2.utils.logging.getLogLevel() == level


def test_readings_of_every_robot_go_there_and_back():
    for name in ("arm_ibvs", "omni_ibvs", "car_line", "quadrotor_perspective"):
        robot = vs.load(name).robot
        q = np.linspace(0.1, 0.5, len(robot.joints))
        given = Reading(q, 2 * q, 0.7 if robot.base == "planar" else None)
        if robot.base == "floating":
            tilt, v, w = np.array([0.1, -0.2]), np.array([1.0, 2, 3]), np.array([0.1, 0.2, 0.3])
            estimate = FlightEstimate(v, w, tilt, w, 0.0, False, False)
            given = FlightReading(q, 2 * q, 0.7, tilt, range_m=1.5, estimate=estimate)
        told = {topic: sent(message) for topic, message in m.readings(3.0, robot, given).items()}
        assert {topic: message.__msgtype__ for topic, message in told.items()} == m.sensors_of(
            robot
        )
        again = m.reading_of(robot, told)
        np.testing.assert_allclose(again.q, q)
        np.testing.assert_allclose(again.qd, 2 * q)
        assert again.heading == (None if given.heading is None else pytest.approx(given.heading))
        if robot.base == "floating":
            np.testing.assert_allclose(again.tilt, given.tilt)
            np.testing.assert_allclose(again.body_twist, given.body_twist)
            assert again.range_m == 1.5 and not again.estimate.overturned
        with pytest.raises(ParameterError, match="nothing was heard"):
            m.reading_of(robot, {})


@pytest.mark.parametrize("o", [(0.0, 0.0, 0.0, 0.0), (1e-9, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)])
def test_an_attitude_that_is_none_is_refused_by_name(o):
    """Zeros are what a driver without an attitude leaves there; level is another thing."""
    scenario = vs.load("car_pbvs")
    with vs.Session(scenario) as session:
        session.reset()
        imu = m.readings(0.0, scenario.robot, session.episode.plant.reading())["imu"]
    m.check_finite("imu", imu)
    imu.orientation.w, imu.orientation.x, imu.orientation.y, imu.orientation.z = o
    with pytest.raises(
        ParameterError,
        match=(
            r"imu.orientation is no unit quaternion;"
            r" a driver without an attitude sets the first number"
        ),
    ):
        m.check_finite("imu", imu)
    imu.orientation_covariance[0] = -1.0
    m.check_finite("imu", imu)


def test_a_range_of_humble_is_read():
    humble = get_typestore(Stores.ROS2_HUMBLE)
    given = m.readings(3.0, (craft := vs.load("quadrotor_perspective").robot), _flying(craft))[
        "range"
    ]
    kind = humble.types[m.RANGE]
    fields = {
        name: getattr(given, name)
        for name in kind.__dataclass_fields__
        if name not in ("ULTRASOUND", "INFRARED", "__msgtype__")
    }
    assert m.from_cdr(bytes(humble.serialize_cdr(kind(**fields), m.RANGE)), m.RANGE).range == 1.5


def _flying(robot):
    zero, tilt = np.zeros(3), np.array([0.1, -0.2])
    q = np.zeros(len(robot.joints))
    return FlightReading(
        q,
        q,
        0.7,
        tilt,
        range_m=1.5,
        estimate=FlightEstimate(zero, zero, tilt, zero, 0.0, False, False),
    )


def test_twists_and_poses_are_what_others_read():
    there = sent(m.twist(0.0, np.arange(6.0), "camera_optical_frame"))
    assert (there.twist.linear.z, there.twist.angular.x) == (2, 3)
    np.testing.assert_array_equal(m.twist_of(there), np.arange(6.0))
    with pytest.raises(ParameterError, match="finite"):
        m.twist_of(m.twist(0.0, np.array([0, 0, np.nan, 0, 0, 0]), ""))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0], [1, 2, 3]
    one = sent(m.transforms(0.0, {("a", "b"): T})).transforms[0]
    q = one.transform.rotation
    assert (one.header.frame_id, one.child_frame_id, one.transform.translation.y) == ("a", "b", 2)
    from scipy.spatial.transform import Rotation

    np.testing.assert_allclose(
        Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix(), T[:3, :3], atol=1e-12
    )
