from glob import glob

from setuptools import find_packages, setup

package_name = "nermo_bringup"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "environment/*.toml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/launch", sorted(glob("launch/*.launch.xml"))),
        *[(f"share/{package_name}/{folder}", sorted(glob(f"{folder}/*.*"))) for folder in sorted(glob("config/*"))],
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="Launch files, configuration, teleoperation, recording and the nermo command.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "nermo = nermo_bringup.cli:main",
            "command_player = nermo_bringup.nodes.command_player:main",
            "joystick = nermo_bringup.nodes.joystick:main",
            "keyboard_teleop = nermo_bringup.nodes.keyboard_teleop:main",
            "recorder = nermo_bringup.nodes.recorder:main",
            "teleop = nermo_bringup.nodes.teleop:main",
            "twin_device = nermo_bringup.nodes.twin_device:main",
        ]
    },
)
