from setuptools import find_packages, setup

package_name = "nermo_control"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "gait/sets/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="Leg and spine kinematics, gaits, motion module and high-level controller of the Nermo robot mouse.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "gait_knowledge_base = nermo_control.nodes.gait_knowledge_base:main",
            "high_level_controller = nermo_control.nodes.high_level_controller:main",
            "motion_module = nermo_control.nodes.motion_module:main",
            "pantograph_controller = nermo_control.nodes.pantograph_controller:main",
            "state_publisher = nermo_control.nodes.state_publisher:main",
            "trajectory_generator = nermo_control.nodes.trajectory_generator:main",
        ]
    },
)
