from setuptools import find_packages, setup

package_name = "nermo_track"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="The pose of the mouse out of film: tags, cameras, and the clock of a film.",
    license="Apache-2.0",
)
