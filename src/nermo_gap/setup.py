from setuptools import find_packages, setup

package_name = "nermo_gap"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "summaries/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="The mouse for simgap: its recordings, experiments and sites, published tables, the live gap.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": ["gap_monitor = nermo_gap.nodes.gap_monitor:main"],
        "simgap.blind_robots": ["nermo_lite = nermo_gap.blind.mouse:nermo_lite"],
    },
)
