SetFactory("OpenCASCADE");
Box(1) = {0.1, -0.02, -0.002, 0.3, 0.04, 0.004};
Physical Volume("PART") = {1};
Physical Surface("ROOT") = Surface In BoundingBox {0.09, -1, -1, 0.11, 1, 1};
Physical Surface("TIP") = Surface In BoundingBox {0.39, -1, -1, 0.41, 1, 1};
Mesh.MeshSizeMax = 0.01;  Mesh.MeshSizeMin = 0.01;  Mesh.ElementOrder = 2;
Mesh.SaveGroupsOfElements = 0;  Mesh.SaveGroupsOfNodes = 1;
