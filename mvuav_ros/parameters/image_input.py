"""What the parameters of several nodes share."""

IMAGE_TRANSPORTS = ('raw', 'compressed', 'ffmpeg', 'foxglove')
HOW_IMAGES_COME = (
    'raw subscribes to the image topic, another to <image topic>/<its name>: compressed for JPEG, '
    'PNG, H.264 and H.265 in CompressedImage, ffmpeg for FFMPEGPacket, foxglove for '
    'CompressedVideo.'
)
"""Description of ``image_transport``."""
OPENCV_THREADS = (
    'Threads that OpenCV may use in the node; 0: its own choice, one for each core. One frame is '
    'rarely worth more than one: two made a whole frame of 1920x1080 slower.'
)
"""Description of ``opencv_threads``."""
MOST_OPENCV_THREADS = 64
AUTOSTART = (
    'Configure and activate at the start. false: wait for a lifecycle manager, or for '
    '`ros2 lifecycle set`.'
)
"""Description of ``autostart``."""
