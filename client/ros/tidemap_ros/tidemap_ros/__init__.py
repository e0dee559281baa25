"""tidemap for ROS 2: sends the observations of a robot, and publishes the map of any time.

``node`` is the only module that starts anything. The other modules are parts of it, and the modules that do not use ROS
(``poses``, ``transforms``, ``records``, ``spool``, ``sender``, ``arrays``, ``clock_words``, ``masks``, ``graph``,
``traversals``) can be used and tested without it.
"""
