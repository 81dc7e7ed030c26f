"""Cameras whose library runs in a process of its own, which may die without the daemon.

::

    the daemon                                             the process `stonefall-cams`
    RemoteCamera ── Call ──> CameraProcess ── socket ──> server ──> HostedCamera, one a camera
    sink <── Frame ───────── CameraProcess <── Delivered ── server <── Frame
                     its image: the very memory that the library received into (`frame_memory`)
"""
