"""The ROS 2 package tidemap_ros, of the build type ament_python."""

from setuptools import setup

NAME = "tidemap_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    package_data={NAME: ["py.typed"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/tidemap.launch.py"]),
        (f"share/{NAME}/config", ["config/tidemap.yaml"]),
    ],
    python_requires=">=3.10",
    install_requires=["setuptools", "numpy>=1.24", "tidemap"],
    zip_safe=True,
    maintainer="The tidemap contributors",
    maintainer_email="tidemap@users.noreply.github.com",
    description="Maps that learn when: sends observations of a robot to tidemap, and publishes the map of any time",
    license="MIT OR Apache-2.0",
    entry_points={"console_scripts": ["tidemap_node = tidemap_ros.node:main"]},
)
