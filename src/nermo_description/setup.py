from glob import glob

from setuptools import find_packages, setup

package_name = "nermo_description"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={
        package_name: [
            "py.typed",
            "robots/*.yaml",
            "scenes/*.xml",
            "mjcf/*.xml",
            "mjcf/*/*.xml",
            "meshes/*",
        ]
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/urdf", sorted(glob("urdf/*.urdf"))),
        (f"share/{package_name}/meshes", sorted(glob(f"{package_name}/meshes/*.stl"))),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="The robots as data: modular MJCF, meshes, URDF, parameter files and their loader.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"export_urdf = {package_name}.scripts.export_urdf:main",
            f"generate_meshes = {package_name}.scripts.generate_meshes:main",
            f"robot_family = {package_name}.scripts.robot_family:main",
        ]
    },
)
