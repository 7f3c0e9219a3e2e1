from setuptools import find_packages, setup

package_name = "nermo_node"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "loopback.xml", "subnet.xml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="What every node shares: running, parameters, QoS, time, diagnostics and lockstep.",
    license="Apache-2.0",
    entry_points={"console_scripts": []},
)
