from setuptools import find_packages, setup

package_name = "nermo_hw"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "link/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="The real robot's path: SBCP protocol, serial driver, Wi-Fi link and safety supervisor.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "device_emulator = nermo_hw.nodes.device_emulator:main",
            "robot_end = nermo_hw.robot_end:main",
            "safety_supervisor = nermo_hw.nodes.safety_supervisor:main",
            "serial_driver = nermo_hw.nodes.serial_driver:main",
            "zenoh_link = nermo_hw.nodes.zenoh_link:main",
        ]
    },
)
