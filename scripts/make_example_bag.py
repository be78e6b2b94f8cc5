#!/usr/bin/env python3
# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Make examples/arm_with_play: 12 s of an arm that has what its robot file does not say."""

from pathlib import Path
import shutil
import sys
import tempfile

from gms_flex_control.cli.main import main
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

ROOT = Path(__file__).resolve().parents[1]
BAG = ROOT / 'examples' / 'arm_with_play'
SUBSTEPS = 400  # per joint state: steps of 10 us, so that integration delays nothing
PLAY = """    effects:
      joint2:
        backlash: {half_gap: 0.012}  # rad
"""


def simulate(folder):
    """Return a bag of the arm with play in its second joint; its controller knows of none."""
    believed = ROOT / 'config' / 'robot.yaml'
    real = folder / 'real.yaml'
    real.write_text(believed.read_text(encoding='utf-8') + PLAY, encoding='utf-8')
    code = main(['simulate', '--robot', str(real), '--model', str(believed), '--set',
                 'rate=250.0', f'substeps={SUBSTEPS}', '--compensation', 'gms', '--duration', '12',
                 '--out', str(folder / BAG.name)])
    if code:
        sys.exit(code)
    return folder / BAG.name


def compress(source, target):
    """Copy an mcap file with its chunks compressed, which every reader of mcap understands."""
    with source.open('rb') as read, target.open('wb') as written:
        reader, writer = make_reader(read), Writer(written, compression=CompressionType.ZSTD)
        writer.start(profile='ros2', library='gms_flex_control')
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    topic=channel.topic, message_encoding=channel.message_encoding,
                    metadata=channel.metadata, schema_id=writer.register_schema(
                        name=schema.name, encoding=schema.encoding, data=schema.data))
            writer.add_message(channels[channel.id], log_time=message.log_time,
                               publish_time=message.publish_time, sequence=message.sequence,
                               data=message.data)
        writer.finish()


if __name__ == '__main__':
    with tempfile.TemporaryDirectory() as scratch:
        made = simulate(Path(scratch))
        shutil.rmtree(BAG, ignore_errors=True)
        BAG.mkdir(parents=True)
        shutil.copy(made / 'metadata.yaml', BAG)
        for file in made.glob('*.mcap'):
            compress(file, BAG / file.name)
