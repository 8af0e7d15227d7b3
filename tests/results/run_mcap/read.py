"""Reads a run.mcap as anybody would, and prints what is in it as JSON."""

import json
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

with open(sys.argv[1], "rb") as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    summary = reader.get_summary()
    counts = summary.statistics.channel_message_counts
    topics = {
        channel.topic: [summary.schemas[channel.schema_id].name, counts.get(id, 0)]
        for id, channel in summary.channels.items()
    }
    metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    attachments = [attachment.name for attachment in reader.iter_attachments()]
    read, last_ns, ordered, estimates = {}, 0, True, []
    for _, channel, message, decoded in reader.iter_decoded_messages(log_time_order=False):
        read[channel.topic] = read.get(channel.topic, 0) + 1
        ordered, last_ns = ordered and message.log_time >= last_ns, message.log_time
        if channel.topic == "/estimate":
            n = len(decoded.state)
            p = decoded.covariance
            estimates.append([decoded.time_s, *decoded.state[:4], p[0], p[1], p[n + 1]])
        if channel.topic == "/scene":
            assert {"estimate", "robots", "ranges"} <= {entity.id for entity in decoded.entities}
        if channel.topic == "/heading":
            commands = len(decoded.commands)

json.dump(
    {
        "topics": topics,
        "read": read,
        "metadata": metadata,
        "attachments": attachments,
        "ordered": ordered,
        "last_ns": last_ns,
        "commands": commands,
        "estimates": estimates,
    },
    sys.stdout,
)
