"""Reading and writing of depth camera logs.

``find_logs`` finds the logs in files and folders, ``open_log`` reads the index and the first
messages of a log, and :class:`Log` reads its frames in batches. Names are imported on first use,
so that importing only ``LogOptions`` does not import the decoders.

The modules, from files to frames::

    files, splits                   paths -> the files of each log
      formats, container            a file of any format: its index, and chunks of MCAP records by
                                      position
        mcap_file, chunks             MCAP: mcap_index walks over the records by their heads; if
                                        that shows damage, mcap_scan also reads the chunks
        bag                           ROS 1
        sqlite, image_folder          ROS 2 and folders, in which each message is a chunk
      file_index                    positions of all messages as arrays, in the same form for all
                                      formats; from the file's own index, or from a scan
      opening, indexed              messages by topic (records); the first of each topic are decoded
                                      (contents), or all small messages and all timestamps
      findings                      cameras, topics, calibration (intrinsics, extrinsics), poses,
                                      transforms, motion
      windows                       any range of frames: order, nearest colour image, poses
                                      (motion_windows), calibration (validity)
    timeline.Window                 positions of the images of some frames
      reading, store                  chunks, each read and checked once, in threads
        raw_messages                  raw pixels, copied directly into arrays; transforms
        decode_messages               CDR, ROS 1, protobuf and JSON -> messages
        images, compressed            their pixels: raw, jpeg, png, zstd_images
        body_mask                     mask of the robot's own body
    log, batch                      arrays of images, timestamps and poses, and each frame's status
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
