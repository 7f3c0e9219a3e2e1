from setuptools import find_packages, setup

# All metadata is here, and pyproject.toml only names the build tool: colcon reads this file and never that one.
package_name = "simgap"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "examples/**/*", "inference/*.yaml", "report/*.j2", "live/page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    python_requires=">=3.11",
    install_requires=[
        "jinja2>=3.0",
        "mujoco-core>=4.0",  # MuJoCo without viewer and renderer, which `mujoco` brings along
        "numpy>=1.26",
        "pint>=0.24",
        "pydantic>=2.0",
        "PyYAML>=6.0",
        "rich>=13",
        "scipy>=1.11",
        "typer>=0.12",
    ],
    extras_require={
        "bags": ["mcap>=1.1", "rosbags>=0.10"],
        "dask": ["distributed>=2024.8"],
        "parquet": ["pyarrow>=16"],
        "test": ["hypothesis", "pytest", "pytest-timeout", "mcap>=1.1", "pyarrow>=16", "rosbags>=0.10"],
    },
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="Diagnosis of the sim-to-real gap of any MuJoCo model: where it lies, which effect causes it.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["simgap = simgap.cli:main"]},
)
