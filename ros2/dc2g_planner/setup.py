"""Installation by colcon, or by pip."""

from setuptools import setup

NAME = "dc2g_planner"

setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", [f"launch/{NAME}.launch.py"]),
        (f"share/{NAME}/config", [f"config/{NAME}.yaml", f"config/{NAME}.rviz"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    description="Exploration toward a door in unknown environments, with the planners of dc2g_jax.",
    license="MIT",
    entry_points={"console_scripts": [f"{NAME} = {NAME}.node:main", f"{NAME}_dds = {NAME}.participant:main"]},
)
