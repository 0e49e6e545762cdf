"""The messages of ../messages.py as CDR."""

from graph import Writer


def message(index, size):
    """The message with this number: a Twist, or an Image with `size` bytes of data."""
    if size == 0:
        value = float(index)
        return Writer().put("d", value, value + 0.25, -value, value * 0.5, 0.0, value / 3.0).done()
    image = Writer().put("i", index).put("I", index + 1).text("camera").put("I", 1, size).text("mono8").put("B", 0)
    return image.put("I", size, size).raw(bytes((index + at) % 251 for at in range(size))).done()


def message_type(size):
    return "geometry_msgs::msg::dds_::Twist_" if size == 0 else "sensor_msgs::msg::dds_::Image_"


def ros_name(topic):
    """`/cmd_vel` for the DDS topic `rt/cmd_vel`."""
    return topic.removeprefix("rt")
