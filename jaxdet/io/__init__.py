"""Logs of depth cameras: recordings to arrays, and arrays to files.

``find_logs`` turns names of files and folders into logs, ``open_log`` reads the index and the first
messages of a log, and :class:`Log` reads its frames in batches. Names are loaded on first use, so
that the options alone import no decoder.

From the bytes of files to frames, by module::

    files, splits                   paths -> the files of each log
      formats, container            a file of any format: chunks of MCAP records by position, and
                                      its index
        mcap_file, chunks             MCAP: mcap_index; if that is damaged, mcap_scan
        bag                           ROS 1
        message_file                  messages one by one: sqlite (ROS 2), image_folder
      file_index                    where every message is: arrays, the same for all formats, by
                                      the file's own index or rebuilt from all that is whole (walk)
      opening, indexed              messages by topic (records), the first of each decoded
                                      (contents); or all small ones and all stamps
      findings                      cameras, topics, calibration (intrinsics, extrinsics), poses,
                                      transforms, motion
      windows                       any range of frames: order, nearest colour, poses
                                      (motion_windows), calibration (validity)
    timeline.Window                 where the images of some frames lie
      reading, store                  chunks, each read and checked once, by threads
        raw_messages                  pixels that go straight into their arrays; transforms
        decode_messages               CDR, ROS 1, protobuf and JSON -> messages
        images, compressed            their pixels: raw, jpeg, png, rvl, zstd_images
        body_mask                     pixels of the robot itself, which are not measured
    log, batch                      arrays of images, stamps and poses, and the status of each
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
