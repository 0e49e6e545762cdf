"""Reads a recording as others do, and prints what they find as JSON: FILE [cut].

With `mcap`: profile, channels, messages in order of log time, metadata. With `rosbags`, as a bag of one file: the fields of every
message; so with `mcap_ros2`, Foxglove's own decoder, by the definitions in the file. `cut` reads a file that has no end, from its beginning, as far as it goes.
"""

import json
import sys
import tempfile
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader

path = Path(sys.argv[1])


def fields(message):
    """The fields of a decoded message."""
    names = [name for name in message.__dataclass_fields__ if not name.startswith("__")]
    values = {name: getattr(message, name) for name in names}
    return {name: fields(value) if hasattr(value, "__dataclass_fields__") else value for name, value in values.items()}


def cut():
    """The messages of a file without an end, and how reading it ended."""
    found, ended = [], "whole"
    with path.open("rb") as file:
        channels = {}
        try:
            for record in StreamReader(file, validate_crcs=True).records:
                if isinstance(record, Channel):
                    channels[record.id] = record.topic
                if isinstance(record, Message):
                    found.append({"topic": channels[record.channel_id], "data": record.data.hex()})
        except McapError as error:
            ended = type(error).__name__
    return {"messages": found, "ended": ended}


def whole():
    """Everything that the index leads to."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        schemas = summary.schemas
        channels = {
            channel.topic: {
                "encoding": channel.message_encoding,
                "type": schemas[channel.schema_id].name,
                "schema_encoding": schemas[channel.schema_id].encoding,
                "about": dict(channel.metadata),
                "count": summary.statistics.channel_message_counts.get(channel.id, 0),
            }
            for channel in summary.channels.values()
        }
        messages = [
            {
                "topic": channel.topic,
                "log_time": message.log_time,
                "publish_time": message.publish_time,
                "sequence": message.sequence,
                "data": message.data.hex(),
            }
            for _, channel, message in reader.iter_messages(log_time_order=True)
        ]
        metadata = [{"name": record.name} | dict(record.metadata) for record in reader.iter_metadata()]
        statistics = summary.statistics
        return {
            "profile": reader.get_header().profile,
            "channels": channels,
            "messages": messages,
            "metadata": metadata,
            "statistics": {
                "messages": statistics.message_count,
                "chunks": statistics.chunk_count,
                "metadata": statistics.metadata_count,
                "start": statistics.message_start_time,
                "end": statistics.message_end_time,
            },
        }


def decoded(found):
    """The messages by topic, as `rosbags` decodes them by the definitions in the file. It compares their hashes, too."""
    with tempfile.TemporaryDirectory() as directory:
        bag = Path(directory)
        (bag / path.name).symlink_to(path.resolve())
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": channel["type"],
                    "serialization_format": channel["encoding"],
                    "offered_qos_profiles": "",
                },
                "message_count": channel["count"],
            }
            for topic, channel in found["channels"].items()
        ]
        about = {
            "version": 5,
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": 0},
            "starting_time": {"nanoseconds_since_epoch": 0},
            "message_count": len(found["messages"]),
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [path.name],
        }
        # JSON is YAML.
        (bag / "metadata.yaml").write_text(json.dumps({"rosbag2_bagfile_information": about}))
        messages = {}
        with AnyReader([bag]) as reader:
            for connection, time, data in reader.messages():
                known = connection.msgdef.data != ""
                shown = fields(reader.deserialize(data, connection.msgtype)) if known else data.hex()
                messages.setdefault(connection.topic, []).append({"time": time, "message": shown})
        return messages


def decoded_by_foxglove(found):
    """The fields of the messages whose definition is in the file, by topic."""

    def plain(value):
        if isinstance(value, (list, tuple)):
            return [plain(item) for item in value]
        names = getattr(value, "__slots__", None)
        return value if names is None else {name: plain(getattr(value, name)) for name in names}

    topics = [topic for topic, channel in found["channels"].items() if channel["schema_encoding"] == "ros2msg"]
    messages = {}
    for message in read_ros2_messages(path, topics=topics):
        messages.setdefault(message.channel.topic, []).append(plain(message.ros_msg))
    return messages


if sys.argv[2:] == ["cut"]:
    print(json.dumps(cut()))
else:
    found = whole()
    print(json.dumps(found | {"decoded": decoded(found), "foxglove": decoded_by_foxglove(found)}))
