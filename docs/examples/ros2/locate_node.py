"""ROS 2 node: images in, the robot's pose and map -> odom out, by localizer.py. Not run yet: written without ROS."""

import cv2
import numpy as np
import rclpy
from example import Locator
from geometry_msgs.msg import PoseWithCovarianceStamped, Quaternion, TransformStamped
from localizer import Localizer
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from sensor_msgs.msg import CompressedImage
from tf2_ros import Buffer, TransformBroadcaster, TransformException, TransformListener

FRAMES = ("map", "odom", "base_footprint")


class LocateNode(Node):
    def __init__(self) -> None:
        super().__init__("deepgps")
        locator = Locator()
        self.localizer = Localizer(locator.locate, locator.meta)
        self.map, self.odom, self.base = (self.declare_parameter(name, name).value for name in FRAMES)
        self.buffer, self.broadcaster = Buffer(), TransformBroadcaster(self)
        self.listener = TransformListener(self.buffer, self)
        self.publisher = self.create_publisher(PoseWithCovarianceStamped, "deepgps/pose", 10)
        self.create_subscription(CompressedImage, "image/compressed", self.see, qos_profile_sensor_data)

    def see(self, message: CompressedImage) -> None:
        picture = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        if picture is None:
            return
        try:
            found = self.buffer.lookup_transform(self.odom, self.base, Time.from_msg(message.header.stamp))
        except TransformException as error:
            self.get_logger().warning(f"no odometry at the time of the image: {error}")
            return
        place, turn = found.transform.translation, found.transform.rotation
        yaw = np.arctan2(2 * (turn.w * turn.z + turn.x * turn.y), 1 - 2 * (turn.y**2 + turn.z**2))
        if (fix := self.localizer.see(picture[..., ::-1].copy(), np.array([place.x, place.y, yaw]))) is None:
            return
        pose = PoseWithCovarianceStamped()
        pose.header.stamp, pose.header.frame_id = message.header.stamp, self.map
        pose.pose.pose.position.x, pose.pose.pose.position.y = fix.map_to_base[:2].tolist()
        pose.pose.pose.orientation = as_quaternion(fix.map_to_base[2])
        pose.pose.covariance = fix.covariance.ravel().tolist()
        self.publisher.publish(pose)
        frame = TransformStamped(header=pose.header, child_frame_id=self.odom)
        frame.transform.translation.x, frame.transform.translation.y = fix.map_to_odom[:2].tolist()
        frame.transform.rotation = as_quaternion(fix.map_to_odom[2])
        self.broadcaster.sendTransform(frame)


def as_quaternion(yaw: float) -> Quaternion:
    return Quaternion(z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2)))


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(LocateNode())
