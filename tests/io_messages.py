"""Messages of MCAP files, read by others: the library of MCAP, and protobuf."""


def messages(path, topic):
    """Yields the messages of a topic, raw and decoded by the schema that the file has."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap.reader import make_reader

    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if channel.topic == topic:
                pool = descriptor_pool.DescriptorPool()
                for part in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(part)
                form = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
                yield message, form.FromString(message.data)
