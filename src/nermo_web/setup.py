from setuptools import find_packages, setup

package_name = "nermo_web"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["py.typed", "page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="Nermo maintainers",
    maintainer_email="maintainers@nermo.example",
    description="The mouse in the browser: seen in 3D, driven with a stick, its parameters as sliders.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["web = nermo_web.nodes.web:main"]},
)
