"""Cameras whose library runs in a process of its own, which may die without the daemon.

::

    the daemon                                             the process `stonefall-cams`
    RemoteCamera ── Call ──> CameraProcess ── socket ──> server ──> AravisCamera, one a camera
    sink <── Frame ───────── CameraProcess <── Delivered ── server <── Frame
                     its image: the very memory that Aravis received into (`frame_memory`)
"""
